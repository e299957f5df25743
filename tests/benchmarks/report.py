"""What a page of `report` costs and holds: python -m tests.benchmarks.report [OPTIONS].

    --transactions 100000
    --rounds 3
    --axe FILE           also run axe-core (npm install axe-core; its axe.min.js) in chromium on the
                         page, and on one of a sick line with hostile texts: light and dark, wide
                         and narrow

Prints the processor time of `report` in times of that of `decode -o x.jsonl` of the same capture,
the size of the page, and how many of its figures differ from those of `stats --json`. Exit 1 if
something is beyond the limits: twice the time, 3 MB, any difference, any serious fault of axe.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from html import unescape
from pathlib import Path
from statistics import median
from typing import Any

from tests.benchmarks.file_workloads import clean, make_capture
from tests.workflows.sick_line import sick_line

MOST_TIMES, MOST_BYTES = 2.0, 3_000_000
PATIENCE_S = 300
HOSTILE = "</script><script>document.title='hacked'</script><img src=x onerror=alert(1)>"
SERIOUS = ("serious", "critical")
_CSP = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')
_RUN = """
const unfold = () => { for (const one of document.querySelectorAll("details")) one.open = true; };
setTimeout(unfold, 3000);
setTimeout(() => axe.run(document, {resultTypes: ["violations"]}).then((found) => {
  const told = found.violations.map((one) => [one.impact, one.id, one.nodes.length]);
  const pre = document.createElement("pre");
  pre.id = "axe";
  pre.textContent = JSON.stringify({told, passes: found.passes.length, title: document.title});
  document.body.append(pre);
}), 4000);
"""


def processor_s(*arguments: object) -> float:
    """Run mbtool; return the processor time that it took, in s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "mbtool", *map(str, arguments)]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def document(page: Path) -> dict[str, Any]:
    """The data of a page."""
    match = re.search(r'id="data"[^>]*>(.*?)</script>', page.read_text(), re.DOTALL)
    assert match is not None
    found: dict[str, Any] = json.loads(match[1])
    return found


def differences(page: Any, stats: Any, at: str = "") -> list[str]:
    """Where the page's figures are not those of stats; histograms of single polls
    and remarks are left out."""
    if isinstance(stats, dict) and isinstance(page, dict):
        left_out = {"histogram"} if ".polls" in at else {"is_whole", "remarks"}
        keys = [key for key in stats if key not in left_out]
        return [
            one for key in keys for one in differences(page.get(key), stats[key], f"{at}.{key}")
        ]
    if isinstance(stats, list) and isinstance(page, list) and len(stats) == len(page):
        pairs = enumerate(zip(page, stats, strict=True))
        return [one for i, (a, b) in pairs for one in differences(a, b, f"{at}[{i}]")]
    return [] if page == stats else [at]


def axe_faults(page: Path, axe: Path, *flags: str) -> dict[str, Any]:
    """What axe-core finds in a page, with its own script let in."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        raise SystemExit("chromium is not installed: apt-get install chromium")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "page.html"
        text = _CSP.sub("", page.read_text())
        script = f"<script>{axe.read_text()}</script><script>{_RUN}</script></body>\n</html>"
        copy.write_text(text.replace("</body>\n</html>", script))
        command = [
            browser, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic",
            "--no-first-run", "--disable-background-networking", "--disable-component-update",
            "--disable-sync", f"--user-data-dir={folder}/profile", "--virtual-time-budget=60000",
            *flags, "--dump-dom", copy.as_uri(),
        ]  # fmt: skip
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=PATIENCE_S, check=True
        )
    match = re.search(r'<pre id="axe">(.*?)</pre>', done.stdout, re.DOTALL)
    assert match is not None, "axe did not end"
    found: dict[str, Any] = json.loads(unescape(match[1]))
    return found


def _axe(page: Path, axe: Path) -> bool:
    is_well = True
    for flags in (
        ["--window-size=1400,4000"],
        ["--window-size=400,4000"],
        ["--window-size=1400,4000", "--force-dark-mode", "--blink-settings=preferredColorScheme=0"],
    ):
        found = axe_faults(page, axe, *flags)
        serious = [one for one in found["told"] if one[0] in SERIOUS]
        is_well &= not serious and "hacked" not in found["title"]
        sys.stdout.write(
            f"axe-core, {page.name}, {' '.join(flags)}: {found['passes']} rules pass, "
            f"{len(found['told'])} do not, {len(serious)} of them serious: {found['told']}\n"
        )
    return is_well


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--transactions", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--axe", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        capture = folder / "plant.pcap"
        made = make_capture(capture, clean, 2 * given.transactions)
        page, lines, figures = (folder / one for one in ("r.html", "x.jsonl", "stats.json"))
        ratios = []
        for _ in range(given.rounds):
            lines.unlink(missing_ok=True)
            rows_s = processor_s("decode", capture, "-o", lines)
            ratios.append(processor_s("report", capture, "-o", page, "--overwrite") / rows_s)
        with figures.open("w") as file:
            command = [sys.executable, "-m", "mbtool", "stats", str(capture), "--json"]
            subprocess.run(command, check=True, stdout=file, stderr=subprocess.DEVNULL)
        shown = document(page)
        verdict = {key: shown["verdict"][key] for key in ("level", "troubles")}
        differing = differences(shown["stats"] | verdict, json.loads(figures.read_text()))
        size = page.stat().st_size
        times = ", ".join(f"{one:.2f}" for one in ratios)
        sys.stdout.write(
            f"{made.transactions:,} transactions: report takes {median(ratios):.2f} times the "
            f"processor time of jsonl ({times}), {size / 1e6:.2f} MB, "
            f"{len(differing)} figures differ from stats --json {differing[:5]}\n"
        )
        is_well = median(ratios) <= MOST_TIMES and size <= MOST_BYTES and not differing
        if given.axe is not None:
            sick, hostile = folder / "sick.html", sick_line(folder / "<b>x.mcap", name=HOSTILE)
            processor_s("report", hostile, "-o", sick)
            is_well &= _axe(page, given.axe)
            is_well &= _axe(sick, given.axe)
    raise SystemExit(0 if is_well else 1)


if __name__ == "__main__":
    main()
