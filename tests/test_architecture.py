"""The rules that no other tool checks, each as a test: a rule without a check is a wish."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("roadgrip", "rsu_app", "vehicle_client", "training")
PURE = (
    "roadgrip",
    "rsu_app/domain",
    "rsu_app/road_import",
    "vehicle_client/estimation",
    "vehicle_client/mapmatch",
    "vehicle_client/pipeline.py",
    "vehicle_client/recording",
    "vehicle_client/vehicle_profile.py",
    "vehicle_client/simulator",
)
SECTION_READING = "roadgrip/sections/__init__.py"
"""The one place of the vocabulary that reads files: both ends of the air name a section alike, and never meet."""
MAX_LINES = 500

# Names that say nothing about what is inside.
EMPTY_NAMES = {"utils", "util", "helpers", "helper", "common", "misc", "manager", "base", "types", "const", "constants"}

# The units a name may end with.
UNITS = set(
    """
    s ms hz bar 1ps m m2 m3 mm mps mps2 mps3 m2ps2 m2ps3 mprad 1pm 1pm2 1pm3 s2pm rad radps radps2 deg kph hour
    kg kgm2 kgpm n nm npm nprad radpn nspm nmprad nmsprad 1pn pa w k c bytes mb px
    """.split()
)
# The last words that say a number has no dimension.
DIMENSIONLESS = set(
    """
    mu ratio frac fraction share shares correlation count number index rank order exponent factor weight weights
    gain scale score level probability quantile speedup loss
    """.split()
)
# Whole names of arrays whose columns have a unit each (the feature table names them), or whose unit is the caller's,
# as in an interpolation or a filter, which work for any quantity.
ANY_UNIT = set(
    "at second lower upper minimum maximum low high knots labels metrics signal derivative matrix x y"
    " misfit variance priors"
    # Vectors over a car's constants, each of its own unit.
    " mean first_std drift_std sensor_stds information pull"
    # Codes, kept among numbers.
    " flags".split()
)
# State is an array: in the simulator these are the arrays whose columns an index of names describes.
STATE_ARRAYS = set("aids body lines log mind road state states wheels".split())
DEGREES_ALLOWED = re.compile(r"(^|_)(lat|lon|latitude|longitude|meridian|angle)_deg$")
QUANTITY = re.compile(
    r"^(float|FloatArray|NDArray\[np\.float(64|32)\]|Sequence\[float\]|list\[float\]|tuple\[float, \.\.\.\])$"
)


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def modules(*places: str) -> list[Path]:
    found: list[Path] = []
    for place in places:
        path = ROOT / place
        found += [path] if path.is_file() else sorted(path.rglob("*.py"))
    return found


def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def project_files() -> list[Path]:
    """List what belongs to the project: what git knows, or would know after `git add`."""
    listing = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    if listing.returncode != 0:
        pytest.skip("not a git checkout: the list of the project's files is unknown")
    return [path for name in listing.stdout.decode().split("\0") if name and (path := ROOT / name).is_file()]


def imported_modules(path: Path) -> set[str]:
    """Name every module that a file imports, wherever in the file it does."""
    names: set[str] = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def within(module: str, *packages: str) -> bool:
    return any(module == package or module.startswith(f"{package}.") for package in packages)


# Import direction ----------------------------------------------------------------------------------------------------


def test_the_import_contracts_are_kept():
    verdict = subprocess.run(
        [
            sys.executable,
            "-c",
            "from importlinter.cli import lint_imports_command as main; main()",
            "--no-cache",
            "--no-logo",
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert verdict.returncode == 0, verdict.stdout + verdict.stderr


def test_the_laboratory_borrows_only_what_decides():
    # import-linter forbids a list of modules; this allows a list, so that a new module is refused until it is named.
    allowed = (
        "rsu_app.domain",
        *(
            f"vehicle_client.{part}"
            for part in ("estimation", "mapmatch", "pipeline", "recording", "simulator", "vehicle_profile")
        ),
    )
    borrowed = {
        f"{relative(path)}: {module}"
        for path in modules("training")
        for module in imported_modules(path)
        if within(module, "rsu_app", "vehicle_client") and not within(module, *allowed)
    }
    assert not borrowed


def test_migrations_know_nothing_of_the_code_they_migrate():
    # A migration must mean tomorrow what it meant when it ran: it cannot lean on code that changes.
    known = {
        f"{relative(path)}: {module}"
        for path in modules("migrations")
        for module in imported_modules(path)
        if within(module, *PACKAGES) or within(module, "sqlalchemy.orm")
    }
    assert not known


# Purity --------------------------------------------------------------------------------------------------------------

IMPURE_CALLS = re.compile(
    r"^(open|print|input|breakpoint"
    r"|time\.\w+|(datetime\.)?(datetime|date)\.(now|today|utcnow)"
    r"|os\.(environ|getenv|urandom)\b.*|uuid\.uuid[14]|secrets\.\w+"
    r"|(np|numpy)\.random\.(?!default_rng$|SeedSequence$|Generator$)\w+)$"
)
# Whatever the path is called, these are what one does to files.
FILE_METHODS = re.compile(
    r"\.(open|(read|write)_(text|bytes)|exists|is_file|is_dir|stat|iterdir|r?glob|mkdir|touch|unlink|rename)$"
)


def calls(path: Path) -> Iterator[tuple[int, str, ast.Call]]:
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            yield node.lineno, ast.unparse(node.func), node


def test_what_decides_reads_no_clock_and_opens_nothing():
    impure = [
        f"{relative(path)}:{line} {name}"
        for path in modules(*PURE)
        for line, name, _ in calls(path)
        if IMPURE_CALLS.match(name) or (FILE_METHODS.search(name) and relative(path) != SECTION_READING)
    ]
    assert not impure


def test_what_decides_is_handed_its_section():
    readers = [
        relative(path)
        for path in modules(*PURE)
        if relative(path) != SECTION_READING and any(within(m, "roadgrip.sections") for m in imported_modules(path))
    ]
    assert not readers


def test_chance_in_what_decides_is_always_seeded():
    unseeded = [
        f"{relative(path)}:{line} {name}()"
        for path in modules(*PURE, "training")
        for line, name, call in calls(path)
        if name.endswith("default_rng") and not call.args and not call.keywords
    ]
    assert not unseeded


# Names and units -----------------------------------------------------------------------------------------------------


def test_no_module_is_named_after_nothing():
    empty = [relative(path) for path in modules(*PACKAGES, "tests", "bench", "deploy") if path.stem in EMPTY_NAMES]
    assert not empty


def carries_its_unit(name: str) -> bool:
    """Judge a name: does it say the unit, or that there is none?"""
    words = name.strip("_").split("_")
    if name.endswith("_deg"):
        return bool(DEGREES_ALLOWED.search(name))
    return (
        name in ANY_UNIT | STATE_ARRAYS
        or words[-1] in {"features", "row", "rows", "value", "values", "samples"}
        or "mu" in words  # friction wears its symbol where the formula has it: mu_new, estimate_mu
        or words[-1] in DIMENSIONLESS
        or (len(words) > 1 and words[-1] in UNITS)
    )


def is_quantity(annotation: ast.expr | None) -> bool:
    if annotation is None:
        return False
    parts = [part.strip() for part in ast.unparse(annotation).split("|")]
    return any(QUANTITY.match(part) for part in parts) and all(QUANTITY.match(part) or part == "None" for part in parts)


def quantities(path: Path) -> Iterator[tuple[int, str]]:
    """List the float parameters of a file's public functions and the float fields of its classes."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("_"):
            for argument in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs):
                if is_quantity(argument.annotation):
                    yield argument.lineno, argument.arg
        elif isinstance(node, ast.ClassDef):
            for statement in node.body:
                match statement:
                    case ast.AnnAssign(target=ast.Name(id=name), annotation=annotation) if (
                        not name.startswith("_") and not name.isupper()
                    ):
                        if is_quantity(annotation):
                            yield statement.lineno, name


def test_every_quantity_carries_its_unit():
    bare = [
        f"{relative(path)}:{line} {name}"
        for path in modules(*PACKAGES)
        for line, name in quantities(path)
        if not carries_its_unit(name)
    ]
    assert not bare, "say the unit (speed_mps) or that there is none (slip_ratio, mu)"


@pytest.mark.parametrize("name", ["speed_mps", "curvature_1pm", "mu_new", "mu", "slip_ratio", "lat_deg", "time_s"])
def test_the_unit_rule_accepts(name):
    assert carries_its_unit(name)


@pytest.mark.parametrize("name", ["speed", "s", "m", "heading_deg", "friction", "duration", "yaw_rate"])
def test_the_unit_rule_refuses(name):
    assert not carries_its_unit(name)


# The repository ------------------------------------------------------------------------------------------------------


def test_no_python_file_outgrows_a_reader():
    long = [
        f"{relative(path)}: {count} lines"
        for path in project_files()
        if path.suffix == ".py" and (count := len(path.read_text(encoding="utf-8").splitlines())) >= MAX_LINES
    ]
    assert not long


def text_of(path: Path) -> str:
    data = path.read_bytes()
    return "" if b"\0" in data[:8_192] else data.decode("utf-8", errors="replace")


def test_no_file_names_a_package_index():
    # A lock that names an index leaks where it was made, and fails wherever that index is not.
    index = re.compile(r"https?" + r"://\S*(/simple\b|pypi|pythonhosted)|--(extra-)?index" + r"-url[ =]+\S*:/")
    named = [relative(path) for path in project_files() if index.search(text_of(path))]
    assert not named


def test_no_file_names_a_place_on_one_machine():
    place = re.compile(r"(?<![\w.$}-])/(home|root|Users|work)" + r"/\w|" + re.escape(str(ROOT)) + r"\b")
    named = [relative(path) for path in project_files() if place.search(text_of(path))]
    assert not named


def test_no_lock_of_a_tool_that_names_indexes_is_committed():
    assert "uv.lock" not in {relative(path) for path in project_files()}


def test_every_line_of_a_lock_is_pinned_and_hashed():
    for lock in sorted((ROOT / "requirements").glob("*.txt")):
        requirements = re.sub(r"\\\n\s*", " ", lock.read_text(encoding="utf-8")).splitlines()
        loose = [
            line for line in requirements if line and not line.lstrip().startswith("#") and "--hash=sha256:" not in line
        ]
        assert not loose, lock.name


@pytest.mark.parametrize("role", ["rsu", "vehicle", "vehicle-files", "training"])
def test_a_role_installs_what_the_tests_ran_with(role):
    def pins(name: str) -> set[str]:
        lock = (ROOT / "requirements" / f"{name}.txt").read_text(encoding="utf-8")
        return set(re.findall(r"^[\w.-]+==\S+", lock, re.MULTILINE))

    assert pins(role) <= pins("dev")


def test_every_warning_that_is_let_through_says_why():
    # Lists of exceptions rot; a comment on each entry keeps it honest.
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    entries = re.search(r"^filterwarnings = \[\n(.*?)^\]", text, re.MULTILINE | re.DOTALL)
    assert entries
    lines = [line for line in entries[1].splitlines() if line.strip().startswith('"ignore')]
    assert [line for line in lines if "#" not in line] == []
