"""The targets asked by a fuzzer that watches which lines are reached (atheris, that is libFuzzer).

python -m tests.fuzz.coverage_guided                     every target for a minute (`make fuzz`)
python -m tests.fuzz.coverage_guided wire --seconds 600  one of them, longer
python -m tests.fuzz.coverage_guided wire --repeat FILE  one input once more

Runs in an environment of its own, for atheris has wheels for few machines. What was reached is kept in build/fuzz and
goes on from there; an input that is a finding is written there too, and belongs into tests/fuzz/corpus once mended.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
WORK_FOLDER = ROOT / "build" / "fuzz"
RESULTS_FILE = ROOT / "docs" / "results" / "fuzz.json"
WATCHED = (
    "roadgrip",
    "rsu_app.adapters.updates.state_file",
    "rsu_app.road_import",
    "rsu_app.setting_groups",
    "rsu_app.settings",
    "vehicle_client.estimation.grip.memory",
    "vehicle_client.recording.signal_mapping",
    "vehicle_client.vehicle_profile",
)
"""Where the fuzzer sees which lines are reached. More only makes it start, and run, slower."""
SECONDS = 60
SLOWEST_S = 5
"""One input that takes longer is a finding."""
MEMORY_LIMIT_MB = 1_000
"""So is one that makes the process larger; the libraries alone take some 200 MB."""
_PROGRESS = re.compile(r"#(\d+)\s.*?cov: (\d+)")
_DONE = re.compile(r"Done (\d+) runs")


def fuzz_here(name: str, seconds: int) -> None:
    """Ask one target in this process until the time is over or something is found; never returns."""
    import atheris

    with atheris.instrument_imports(include=list(WATCHED)):
        from tests.fuzz.seeds import seeds
        from tests.fuzz.targets import TARGETS
    target = TARGETS[name]
    folder = _folder_of(name)
    for number, seed in enumerate(seeds()[name]):
        (folder / f"seed-{number}").write_bytes(seed)
    options = [
        f"-max_total_time={seconds}",
        f"-timeout={SLOWEST_S}",
        f"-rss_limit_mb={MEMORY_LIMIT_MB}",
        f"-max_len={target.limit_bytes}",
        f"-artifact_prefix={WORK_FOLDER}/finding-{name}-",
        "-print_final_stats=1",
        str(folder),
    ]
    atheris.Setup([sys.argv[0], *options], target.check)
    atheris.Fuzz()


def _folder_of(name: str) -> Path:
    folder = WORK_FOLDER / name
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _asked(name: str, seconds: int) -> dict[str, Any]:
    """Return what became of one target, asked in a process of its own: a finding ends it."""
    started_s = time.monotonic()
    command = [sys.executable, "-m", "tests.fuzz.coverage_guided", name, "--seconds", str(seconds), "--here"]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, errors="replace", check=False)
    told = ended.stderr + ended.stdout
    reached = [int(found[2]) for found in _PROGRESS.finditer(told)]
    tried = [int(found[1]) for found in _PROGRESS.finditer(told)] + [int(found[1]) for found in _DONE.finditer(told)]
    if ended.returncode != 0:
        (WORK_FOLDER / f"finding-{name}.log").write_text(told[-20_000:], encoding="utf-8")
    return {
        "target": name,
        "seconds": round(time.monotonic() - started_s),
        "inputs_count": max(tried, default=0),
        "places_reached_count": max(reached, default=0),
        "found": ended.returncode != 0,
    }


def _last_words(name: str) -> str:
    lines = (WORK_FOLDER / f"finding-{name}.log").read_text(encoding="utf-8").splitlines()
    errors = [line for line in lines if re.match(r"\s*(\w+\.)*\w*(Error|Exception)\b|.*ERROR: libFuzzer", line)]
    return errors[0].strip() if errors else (lines[-1] if lines else "no words")


def main(arguments: Sequence[str] | None = None) -> int:
    """Ask the targets that were named, or all, and say what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("target", nargs="*", help="all of them if left out")
    parser.add_argument("--seconds", type=int, default=SECONDS, help="for each target")
    parser.add_argument("--repeat", type=Path, help="ask one target this input, without a fuzzer")
    parser.add_argument("--keep", action="store_true", help="write docs/results/fuzz.json")
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.here:
        fuzz_here(options.target[0], options.seconds)
    from tests.fuzz.targets import TARGETS

    unknown = sorted(set(options.target) - set(TARGETS))
    if unknown or (options.repeat and len(options.target) != 1):
        parser.error(f"no target {', '.join(unknown)}; there are {', '.join(TARGETS)}")
    if options.repeat:
        TARGETS[options.target[0]].check(options.repeat.read_bytes())
        print("the promise is kept")
        return 0
    WORK_FOLDER.mkdir(parents=True, exist_ok=True)
    results = []
    for name in options.target or TARGETS:
        results.append(_asked(name, options.seconds))
        verdict = _last_words(name) if results[-1]["found"] else "nothing found"
        print(
            f"{name:16} {results[-1]['seconds']:5d} s {results[-1]['inputs_count']:10,d} inputs "
            f"{results[-1]['places_reached_count']:6,d} places  {verdict}",
            flush=True,
        )
    if options.keep:
        RESULTS_FILE.write_text(json.dumps({"targets": results}, indent=1) + "\n", encoding="utf-8")
    found = [each["target"] for each in results if each["found"]]
    if found:
        print(f"findings in {', '.join(found)}: see {WORK_FOLDER.relative_to(ROOT)}/finding-*", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
