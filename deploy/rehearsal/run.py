"""`make mlops-demo`: the operators' loop from nothing, in minutes, while you watch.

A laboratory makes keys, trains a champion on a small design and releases it. Two road side units run it, one in the
canary ring. They are asked for what they kept, a friction trailer measures the road, and a challenger is trained with
both. The gate holds it against the champion; it goes to the canary, and from there to all, while vehicles pass. Then
somebody forgets the winter: a model of dry roads is released over the gate's verdict, and the road turns icy.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from deploy.demo.story import Check
from deploy.playing import run_play
from deploy.rehearsal.commands import Operator, RehearsalError
from deploy.rehearsal.traffic import SECTION, Drive, Traffic, drives_of
from deploy.rehearsal.units import Unit
from deploy.rehearsal.warm import WarmPrograms

FOLDER = Path("build") / "mlops-demo"
MARK = "rehearsal"
"""A folder that holds this file, or nothing, may be emptied for a new run."""
THRESHOLDS = Path(__file__).with_name("thresholds.toml")
DRY_MU, DRY_FROM_MU, ICY_MU = 0.6, 0.5, 0.25
TRAILER_SD_MU = 0.02
LAB = "lab"
KEYS = "keys"
CHAMPION, CHALLENGER, CARELESS = "work/champion", "work/challenger", "work/careless"


@dataclass(frozen=True, slots=True)
class Sizes:
    """How much of everything.

    Attributes:
        champion: Options of the champion's design.
        more: Of the drives that the challenger learns from besides.
        holdouts: Of the hold-outs.
        traffic: Of the drives that are sent to units.
        trees: Of every retraining.
        measured_count: Passages that the trailer's measurement speaks of.
        passages_count: How long a new bundle is compared, before and after the switch.
    """

    champion: str = "--runs 2 --random-roads 12 --random-runs 1"
    more: str = "--runs 6 --random-roads 36 --random-runs 1"
    holdouts: str = "--runs 4 --random-roads 20"
    traffic: str = "--runs 60"
    trees: str = "--trees 120 --depth 5"
    measured_count: int = 40
    passages_count: int = 20


FULL = Sizes()
QUICK = Sizes(
    more="--runs 3 --random-roads 20 --random-runs 1",
    holdouts="--runs 4 --random-roads 12",
    traffic="--runs 44",
    trees="--trees 60 --depth 5",
    measured_count=30,
    passages_count=15,
)
"""For a hurry and for tests."""


def prepare_folder(folder: Path) -> None:
    """Make an empty folder, and throw away only what an earlier rehearsal left there.

    Raises:
        RehearsalError: It holds something else.
    """
    if folder.exists() and any(folder.iterdir()):
        if not (folder / MARK).exists():
            raise RehearsalError(f"{folder} is not empty and was not made by a rehearsal; choose another --folder")
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MARK).touch()


class Rehearsal:
    """The story, act by act.

    Args:
        folder: Where everything is left.
        sizes: How much of everything.
        console: Where it is told.
        programs: Run the commands.
        seed: Of everything random.
    """

    def __init__(self, folder: Path, sizes: Sizes, console: Console, *, programs: WarmPrograms, seed: int) -> None:
        self.folder = folder
        self.sizes = sizes
        self.seed = seed
        self.checks: list[Check] = []
        self.units: list[Unit] = []
        self.traffic: dict[str, Traffic] = {}
        self.operator = Operator(
            folder, lambda line: console.print(line, style="cyan", highlight=False, soft_wrap=True), programs
        )
        self._console = console
        self._started_s = time.monotonic()
        self._rng = np.random.default_rng(seed)

    def play(self) -> bool:
        """Return whether everything came as promised."""
        try:
            self._found_a_laboratory()
            champion = self._train_a_champion()
            self._start_units(champion)
            drives = drives_of(self.folder / "traffic")
            measured = [drive for drive in drives if drive.base_mu == DRY_MU][: self.sizes.measured_count]
            dry = [drive for drive in drives if drive.base_mu >= DRY_FROM_MU and drive not in measured]
            icy = [drive for drive in drives if drive.base_mu == ICY_MU]
            self._bring_ground_truth(measured)
            challenger = self._train_a_challenger()
            # A vehicle passes each unit once: the same values again would be a replay.
            waiting = {unit.ring: iter(dry) for unit in self.units}
            self._release(challenger, waiting)
            self._forget_the_winter(challenger, waiting["canary"], iter(icy))
            self._tell_what_was_done(champion, challenger)
        finally:
            for unit in self.units:
                unit.stop()
        return all(check.kept for check in self.checks)

    def _found_a_laboratory(self) -> None:
        self._act("A laboratory, its keys, and drives that only judge")
        types, sizes = self.operator.types, self.sizes
        types(f"roadgrip-train keys init --keys {KEYS} --lab {LAB}")
        types(f"roadgrip-train data holdouts --lab {LAB} --work work/holdouts {sizes.holdouts}")
        design = "roadgrip-train simulate --design default-bundle --sensors automotive"
        types(f"{design} {sizes.champion} --seed {self.seed} --out work/first")
        types(f"{design} {sizes.more} --seed {self.seed + 1} --out work/more")
        types(
            f"roadgrip-train simulate --section {SECTION} --sensors automotive {sizes.traffic} --seed {self.seed + 2} "
            "--out traffic"
        )
        for name in ("first", "more"):
            types(
                f"roadgrip-train data add work/{name} --lab {LAB} --name {name} --licence CC0-1.0 "
                f"--origin 'simulated for the rehearsal'"
            )

    def _train_a_champion(self) -> str:
        self._act("A champion from a few hundred drives, for everybody")
        types = self.operator.types
        types(f"roadgrip-train retrain --lab {LAB} --data first {self.sizes.trees} --out {CHAMPION} --name champion")
        types(f"roadgrip-train promote --lab {LAB} --keys {KEYS} --ring canary --reason 'the first model'")
        types(
            f"roadgrip-train promote --lab {LAB} --keys {KEYS} --ring all --model canary "
            "--override 'the first model: there is nothing yet to hold it against'"
        )
        return _bundle_id(self.folder / CHAMPION)

    def _start_units(self, champion: str) -> None:
        self._act("Two road side units, delivered with the champion")
        lab = self.folder / LAB
        for ring in ("canary", "all"):
            unit = Unit(
                self.folder / f"{ring}-unit",
                ring=ring,
                factory=self.folder / CHAMPION,
                repository=lab / "repository",
                trusted_root=lab / "repository" / "trusted-root.json",
                passages_count=self.sizes.passages_count,
            )
            self.units.append(unit)
            self.traffic[ring] = Traffic(unit.url, rng=unit.rng)
            unit.wait_until_ready()
            self._say(f"the unit of ring {ring} answers at {unit.url} with bundle {unit.live_id}")
            self._check(f"the unit of ring {ring} runs the champion", unit.live_id == champion, unit.live_id)

    def _bring_ground_truth(self, measured: list[Drive]) -> None:
        self._act("Vehicles pass; a friction trailer measures the road; the unit is asked for what it kept")
        began = datetime.now(UTC)
        count = self.traffic["canary"].send(measured)
        ended = datetime.now(UTC)
        (self.folder / "trailer.csv").write_text(
            "section_id,from_utc,until_utc,mu,mu_sd,instrument\n"
            f"{SECTION},{began.isoformat()},{ended.isoformat()},{DRY_MU},{TRAILER_SD_MU},a trailer of the rehearsal\n",
            encoding="utf-8",
        )
        types = self.operator.types
        types("roadgrip-rsu export --config canary-unit/rsu.toml --out canary.ndjson.gz")
        types(
            f"roadgrip-train ground-truth import trailer.csv --lab {LAB} --name trailer --licence CC0-1.0 "
            "--origin 'the rehearsal'"
        )
        types(f"roadgrip-train data join --lab {LAB} --ground-truth trailer --export canary.ndjson.gz --name measured")
        said = types(f"roadgrip-train data list --lab {LAB} --json")
        rows = sum(card["rows_count"] for card in said.document if card["kind"] == "measured")
        self._check("the trailer's measurement found its passages", rows >= count // 2, f"{rows} of {count}")

    def _train_a_challenger(self) -> str:
        self._act("A challenger from more drives and the ground truth, held against the champion")
        types = self.operator.types
        measured = [
            card["name"]
            for card in types(f"roadgrip-train data list --lab {LAB} --json").document
            if card["kind"] == "measured"
        ]
        data = " ".join(f"--data {name}" for name in ("first", "more", *measured))
        types(f"roadgrip-train retrain --lab {LAB} {data} {self.sizes.trees} --out {CHALLENGER} --name challenger")
        bundle_id = _bundle_id(self.folder / CHALLENGER)
        said = types(
            f"roadgrip-train gate --lab {LAB} --challenger challenger --champion champion "
            f"--thresholds {THRESHOLDS} --json",
            expected=(0, 1),
        )
        self._check("the challenger passes the gate", said.code == 0, _failures(said.document))
        return bundle_id

    def _release(self, challenger: str, waiting: dict[str, Iterator[Drive]]) -> None:
        canary, everybody = self.units
        for unit, alias in ((canary, "challenger"), (everybody, "canary")):
            self._act(f"The challenger for ring {unit.ring}, under traffic")
            traffic = self.traffic[unit.ring]
            before = len(traffic.acknowledged)
            with traffic.flowing(waiting[unit.ring]):
                self.operator.types(
                    f"roadgrip-train promote --lab {LAB} --keys {KEYS} --ring {unit.ring} --model {alias} "
                    "--reason 'more drives, and ground truth'"
                )
                unit.wait_for("a switch to the challenger", partial(unit.told, "confirmed", challenger))
            count = len(traffic.acknowledged) - before
            self._say(f"{count} vehicles passed meanwhile; bundle {unit.live_id} is live")
            self._check(f"the unit of ring {unit.ring} switched live", unit.live_id == challenger, unit.live_id)
            self._no_passage_lost(unit)
        self.operator.types("roadgrip-rsu status --config canary-unit/rsu.toml")

    def _forget_the_winter(self, challenger: str, dry: Iterator[Drive], icy: Iterator[Drive]) -> None:
        self._act("Somebody forgets the winter: a model of dry roads, released over the gate's verdict")
        types, (canary, _) = self.operator.types, self.units
        _keep_dry_roads(self.folder / "work" / "more", self.folder / "work" / "dry")
        types(
            f"roadgrip-train data add work/dry --lab {LAB} --name dry --licence CC0-1.0 "
            "--origin 'the drives of the rehearsal, without those on slippery roads'"
        )
        types(f"roadgrip-train retrain --lab {LAB} --data dry {self.sizes.trees} --out {CARELESS} --name careless")
        careless = _bundle_id(self.folder / CARELESS)
        said = types(
            f"roadgrip-train gate --lab {LAB} --challenger challenger --champion champion --thresholds {THRESHOLDS} "
            "--json",
            expected=(0, 1),
        )
        self._check("the gate refuses a model without winter", said.code == 1, _failures(said.document))
        refused = types(f"roadgrip-train promote --lab {LAB} --keys {KEYS} --ring canary", expected=(2,))
        self._check("it is not promoted without a passed gate", refused.code == 2, "exit code 2")
        types(
            f"roadgrip-train promote --lab {LAB} --keys {KEYS} --ring canary "
            "--override 'a rehearsal: what becomes of a bad model?'"
        )
        traffic = self.traffic["canary"]
        with traffic.flowing(dry):
            canary.wait_for("a switch to the careless model", partial(canary.told, "switched", careless))
        self._say(f"on the dry road nobody notices: bundle {careless} is live. Now the road turns icy.")
        with traffic.flowing(icy):
            canary.wait_for("the roll-back", partial(canary.told, "rolled_back", careless))
        self._check("the unit rolled back by itself", canary.live_id == challenger, canary.live_id)
        self._no_passage_lost(canary)

    def _tell_what_was_done(self, champion: str, challenger: str) -> None:
        self._act("Who let which model out, when and why")
        types = self.operator.types
        for line in (
            "roadgrip-rsu ledger show --config canary-unit/rsu.toml",
            f"roadgrip-train ledger show --lab {LAB}",
            f"roadgrip-train models list --lab {LAB}",
        ):
            self._say(types(line).text.rstrip())
        for line in (
            "roadgrip-rsu ledger verify --config canary-unit/rsu.toml",
            "roadgrip-rsu ledger verify --config all-unit/rsu.toml",
            f"roadgrip-train ledger verify --lab {LAB}",
            f"roadgrip-train repository verify --lab {LAB} --trusted-root {LAB}/repository/trusted-root.json",
        ):
            self._check(f"`{' '.join(line.split()[:3])}` finds nothing wrong", types(line).code == 0, "exit code 0")
        spoken = {row[0] for unit in self.units for row in unit.rows("SELECT DISTINCT bundle_id FROM passages")}
        self._check("every estimate names its bundle", {champion, challenger} <= spoken, ", ".join(sorted(spoken)))

    def _no_passage_lost(self, unit: Unit) -> None:
        traffic = self.traffic[unit.ring]
        stored = {bytes(row[0]) for row in unit.rows("SELECT passage_id FROM passages")}
        lost_count = len(set(traffic.acknowledged) - stored) + len(traffic.lost)
        self._check(
            f"no passage of ring {unit.ring} was lost or refused",
            lost_count == 0,
            f"{len(stored)} stored, {lost_count} lost",
        )

    def _act(self, title: str) -> None:
        self._console.print()
        self._console.rule(f"[bold]{title}[/bold]  {time.monotonic() - self._started_s:.0f} s", align="left")

    def _say(self, text: str) -> None:
        self._console.print(text, highlight=False, soft_wrap=True)

    def _check(self, promise: str, kept: bool, found: str) -> None:  # noqa: FBT001 - the verdict itself
        self.checks.append(Check(promise, kept, found))
        self._console.print(
            f"{'[green]kept[/green]' if kept else '[red]BROKEN[/red]'} {promise}: {found}", soft_wrap=True
        )


def _bundle_id(folder: Path) -> str:
    return str(json.loads((folder / "manifest.json").read_text(encoding="utf-8"))["bundle_id"])


def _failures(verdict: dict[str, list[dict[str, object]]]) -> str:
    failed = [check for check in verdict["checks"] if check["required"] and not check["passed"]]
    return "; ".join(str(check["sentence"]) for check in islice(failed, 3)) or "every check passed"


def _keep_dry_roads(source: Path, target: Path) -> None:
    """Write the drives of a design that were driven on good roads."""
    from training.dataset import RUNS_FILE_NAME, read_description, read_runs, write_runs

    runs = read_runs(source)
    target.mkdir(parents=True)
    dry = runs.rows(np.flatnonzero(runs.labels["base_friction_mu"] >= DRY_FROM_MU - 0.05))
    write_runs(dry, target / RUNS_FILE_NAME, description=read_description(source / RUNS_FILE_NAME))


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def rehearse(
    *,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer drives and smaller trees.")] = False,
    seed: Annotated[int, typer.Option(min=1, help="The same seed brings the same drives.")] = 1,
    folder: Annotated[Path, typer.Option(help="Where everything is left.")] = FOLDER,
) -> None:
    """Watch the operators' loop: train, judge, sign, roll out, watch, roll back."""
    console = Console()
    prepare_folder(folder)
    with WarmPrograms() as programs:
        rehearsal = Rehearsal(folder.resolve(), QUICK if quick else FULL, console, programs=programs, seed=seed)
        kept = rehearsal.play()
    table = Table("promise", "kept", "found", title="What was promised")
    for check in rehearsal.checks:
        table.add_row(check.promise, "yes" if check.kept else "NO", check.detail)
    console.print(table)
    console.print("Where to look next:", highlight=False)
    console.print(f"  experiments   roadgrip-train ui --lab {folder / LAB}   (records in {folder / LAB / 'mlflow.db'})")
    console.print(f"  verdicts      {folder / LAB / 'verdicts'}/*/verdict.html")
    console.print(f"  repository    {folder / LAB / 'repository'}")
    console.print("  the year      docs/operators.md", highlight=False)
    raise typer.Exit(0 if kept else 1)


def main() -> None:
    """Run the play."""
    run_play(app, name="mlops-demo")


if __name__ == "__main__":
    main()
