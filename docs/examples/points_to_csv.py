"""Write every value of a capture as a row of CSV: `points_to_csv.py FILE [PROFILE]`."""

from __future__ import annotations

import csv
import sys

import mbtool


def main(path: str, profile: str | None = None) -> None:
    capture = mbtool.open(path, devices={"all": profile} if profile else None)
    writer = csv.writer(sys.stdout)
    writer.writerow(mbtool.PointRow._fields)
    writer.writerows(capture.points())


if __name__ == "__main__":
    main(*sys.argv[1:])
