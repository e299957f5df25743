"""Prints what `check` names of sick lines and networks: `python -m tests.adversary.illnesses`."""

from __future__ import annotations

import argparse
import sys
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.adversary.illnesses import lines, networks
from tests.adversary.illnesses.measuring import judge, table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1000, help="the first seed")
    parser.add_argument("--every", type=int, default=1, help="judge one of so many cases")
    parser.add_argument("--only", default="", help="judge only illnesses whose code has this text")
    parser.add_argument("--keep", type=Path, help="a folder for the recordings that were judged")
    options = parser.parse_args()
    cases = [*lines.cases(options.seed), *networks.cases(options.seed)]
    cases = [one for one in cases if options.only in (one.illness or "healthy")]
    verdicts = []
    with TemporaryDirectory() as temporary:
        for number, case in enumerate(islice(cases, None, None, options.every)):
            folder = Path(temporary)
            if options.keep is not None:
                folder = options.keep / f"{number:04}"
                folder.mkdir(parents=True, exist_ok=True)
            verdict = judge(case, folder)
            verdicts.append(verdict)
            if not verdict.is_named or verdict.wrong or verdict.false_errors:
                sys.stdout.write(
                    f"{number:4} {case}: {' '.join(verdict.codes) or 'nothing'};"
                    f" wrong {' '.join(verdict.wrong) or 'none'};"
                    f" errors {', '.join(verdict.false_errors) or 'none'}\n"
                )
                sys.stdout.flush()
    sys.stdout.write(table(verdicts) + "\n")


if __name__ == "__main__":
    main()
