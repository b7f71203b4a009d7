"""`make deb`: the Debian package of the road side unit, from this checkout and its hashed lock alone.

The package brings a Python environment of its own for the python3 of the Debian release it is meant for. Nothing is run
that is meant for the other processor: wheels are unpacked, compiled Python is the same on all. So one machine makes the
packages of both. The same checkout makes the same bytes.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import json
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
FILES = Path(__file__).resolve().parent / "files"
LOCK = ROOT / "requirements" / "rsu.txt"
PLACE = Path("usr/lib/roadgrip")
DOCUMENTS = Path("usr/share/doc/roadgrip-rsu")
PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
NEXT_PYTHON = f"{sys.version_info.major}.{sys.version_info.minor + 1}"
SCRIPTS = ("postinst", "prerm", "postrm")
CONFIGURATION = "/etc/roadgrip/rsu.toml"

# What only whoever builds or tests a library needs, and of our own wheel what a road side unit never runs.
UNNEEDED_FOLDERS = (
    "bin",
    "training",
    "vehicle_client",
    "numpy/f2py",
    "numpy/_core/include",
    "onnxruntime/backend",
    "onnxruntime/datasets",
    "onnxruntime/quantization",
    "onnxruntime/tools",
    "onnxruntime/transformers",
    "sqlalchemy/testing",
)
UNNEEDED_NAMES = (
    "onnxruntime/capi/libonnxruntime.so*",  # for programs in C; the module beside it holds all of it once more
    "**/tests",
    "**/test_data",
    "**/*.pyi",
    "**/*.pyx",
    "**/*.pxd",
    "**/*.c",
    "**/*.h",
    "**/*.a",
)
# Notes of the installer: paths and times of the machine that built.
INSTALLER_NOTES = ("direct_url.json", "uv_cache.json", "uv_build.json", "REQUESTED")


@dataclass(frozen=True, slots=True)
class Processor:
    """A kind of machine that packages are made for.

    Attributes:
        architecture: What Debian calls it.
        machine: What the kernel calls it.
        wheels: Which wheels it takes; older tags than 2_28 would give an onnxruntime of years ago on aarch64.
    """

    architecture: str
    machine: str
    wheels: str


PROCESSORS = (
    Processor("amd64", "x86_64", "x86_64-manylinux_2_28"),
    Processor("arm64", "aarch64", "aarch64-manylinux_2_28"),
)


class BuildError(Exception):
    """The package cannot be made here; the message says why."""


def build(processor: Processor, *, revision: str, out: Path, work: Path) -> Path:
    """Return the package that was made.

    Args:
        processor: What it shall run on.
        revision: Debian's part of the version; a higher one is an upgrade.
        out: Folder for the package.
        work: Folder for what comes before it; emptied first.

    Raises:
        BuildError: A tool is missing or fails.
    """
    if shutil.which("dpkg-deb") is None:
        raise BuildError("dpkg-deb is missing; on Debian it is in the package dpkg")
    epoch_s = source_date_s()
    environment = {**os.environ, "SOURCE_DATE_EPOCH": str(epoch_s), "PYTHONHASHSEED": "0"}
    shutil.rmtree(work, ignore_errors=True)
    tree = work / "tree"
    packages = tree / PLACE / "lib" / f"python{PYTHON}" / "site-packages"
    packages.mkdir(parents=True)
    wheel = _wheel(work / "wheel", environment)
    _install(packages, processor, wheel)
    _trim(packages)
    _interpreter(tree)
    _compile(tree, environment)
    contents = contents_of(packages)
    refuse_gaps(packages)
    _surroundings(tree, contents)
    version = debian_version(wheel.name.split("-")[1], revision=revision)
    _control(tree, processor, version)
    _settle(tree, epoch_s=epoch_s)
    out.mkdir(parents=True, exist_ok=True)
    package = out / f"roadgrip-rsu_{version}_{processor.architecture}.deb"
    # xz makes it a fifth smaller in ten times the time.
    packing = ("dpkg-deb", "--root-owner-group", "-Zzstd", "-z12")
    _run(*packing, "--build", str(tree), str(package), environment=environment)
    return package


def debian_version(version: str, *, revision: str) -> str:
    """Return a version as Debian sorts it: what comes before a release is older than it."""
    return re.sub(r"\.?(a|b|rc|dev)(?=\d)", r"~\1", version) + f"-{revision}"


def source_date_s() -> int:
    """Return the one moment that all files of the package bear: SOURCE_DATE_EPOCH, or the newest commit's."""
    given = os.environ.get("SOURCE_DATE_EPOCH")
    if given:
        return int(given)
    found = subprocess.run(
        ["git", "log", "-1", "--format=%ct"],  # noqa: S607 - whichever git there is
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    return int(found.stdout) if found.returncode == 0 else int((ROOT / "pyproject.toml").stat().st_mtime)


def contents_of(packages: Path) -> list[dict[str, Any]]:
    """Return every distribution inside with its version, licence and size, largest first."""
    told = [
        {
            "name": found.name,
            "version": found.version,
            "licence": _licence(found),
            "size_bytes": sum(path.stat().st_size for path in _files_of(found, packages)),
        }
        for found in distributions(path=[str(packages)])
    ]
    return sorted(told, key=lambda each: (-int(str(each["size_bytes"])), str(each["name"])))


def refuse_gaps(packages: Path) -> None:
    """Do nothing if all that a road side unit asks for is inside: a lock may be older than what it should hold.

    Raises:
        BuildError: Something is missing; the message names it.
    """
    found = {canonicalize_name(each.name): each for each in distributions(path=[str(packages)])}
    wanted = map(Requirement, found[canonicalize_name("roadgrip")].requires or ())
    missing = [
        str(each)
        for each in wanted
        if each.marker is None or any(each.marker.evaluate({"extra": extra}) for extra in ("", "rsu"))
        if canonicalize_name(each.name) not in found
    ]
    if missing:
        raise BuildError(f"{LOCK.name} lacks {', '.join(missing)}; `make lock` remakes it")


def _licence(distribution: Distribution) -> str:
    said = distribution.metadata
    expressed, plain = (next(iter(said.get_all(name) or ()), "") for name in ("License-Expression", "License"))
    classified = [line.split("::")[-1].strip() for line in said.get_all("Classifier") or () if "License ::" in line]
    # The old field may hold the whole text.
    return expressed or ", ".join(classified) or next(iter(plain.splitlines()), "see its folder")


def _files_of(distribution: Distribution, packages: Path) -> Iterator[Path]:
    for file in distribution.files or ():
        path = packages / str(file)
        if path.is_file():
            yield path
            yield from path.parent.glob(f"__pycache__/{path.stem}.*.pyc") if path.suffix == ".py" else ()


def _wheel(folder: Path, environment: Mapping[str, str]) -> Path:
    _run(
        *(sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", str(folder), str(ROOT)),
        environment=environment,
    )
    (wheel,) = folder.glob("*.whl")
    return wheel


def _install(packages: Path, processor: Processor, wheel: Path) -> None:
    """Put the locked distributions and the wheel into a folder; nothing of them is run."""
    uv = Path(sys.executable).with_name("uv")
    if not uv.exists():
        raise BuildError(f"{uv} is missing: `make setup` brings it")
    install = (str(uv), "pip", "install", "--quiet", "--python", sys.executable, "--target", str(packages))
    platform_wanted = ("--python-platform", processor.wheels, "--python-version", PYTHON, "--only-binary", ":all:")
    environment = {**os.environ, "UV_LINK_MODE": "copy"}  # links would lead into the cache
    _run(*install, *platform_wanted, "--no-deps", "--require-hashes", "-r", str(LOCK), environment=environment)
    _run(*install, *platform_wanted, "--no-deps", "--offline", str(wheel), environment=environment)
    wrong = [path.name for path in packages.rglob("*.so*") if path.is_file() and not _is_for(path, processor)]
    if wrong:
        raise BuildError(f"not for {processor.machine}: {', '.join(wrong)}")


def _is_for(library: Path, processor: Processor) -> bool:
    """Return whether a shared library is for a processor, as its header says."""
    with library.open("rb") as file:
        header = file.read(20)
    number = {"x86_64": 0x3E, "aarch64": 0xB7}[processor.machine]
    return header[:4] == b"\x7fELF" and int.from_bytes(header[18:20], "little") == number


def _trim(packages: Path) -> None:
    for name in UNNEEDED_FOLDERS:
        shutil.rmtree(packages / name, ignore_errors=True)
    for pattern in UNNEEDED_NAMES:
        for path in list(packages.glob(pattern)):
            _remove(path)
    for name in INSTALLER_NOTES:
        for path in list(packages.glob(f"*.dist-info/{name}")):
            path.unlink()
    for path in list(packages.rglob("__pycache__")):
        _remove(path)
    # uv's own lock of a folder that it fills.
    (packages / ".lock").unlink(missing_ok=True)
    for record in packages.glob("*.dist-info/RECORD"):
        lines = record.read_text(encoding="utf-8").splitlines(keepends=True)
        kept = [line for line in lines if (packages / line.rsplit(",", 2)[0].strip('"')).is_file()]
        record.write_text("".join(kept), encoding="utf-8")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _interpreter(tree: Path) -> None:
    """Make the folder an environment of Debian's own Python, at the place where it will lie."""
    (tree / PLACE / "bin").mkdir()
    (tree / PLACE / "bin" / "python").symlink_to(f"/usr/bin/python{PYTHON}")
    (tree / PLACE / "pyvenv.cfg").write_text(
        f"home = /usr/bin\ninclude-system-site-packages = false\nversion = {PYTHON}\n", encoding="utf-8"
    )


def _compile(tree: Path, environment: Mapping[str, str]) -> None:
    """Compile all Python, never to be compared with its source: dpkg owns both, and nobody writes beside it."""
    options = ("-q", "-j", "1", "--invalidation-mode", "unchecked-hash", "-s", str(tree), "-p", "/")
    _run(sys.executable, "-m", "compileall", *options, str(tree / PLACE / "lib"), environment=environment)


def _surroundings(tree: Path, contents: list[dict[str, Any]]) -> None:
    """Put what surrounds the environment into place: settings, unit, command and documents."""
    sys.path.insert(0, str(ROOT))
    from rsu_app.settings import settings_table

    _copy(FILES / "rsu.toml", tree / CONFIGURATION.lstrip("/"))
    _copy(ROOT / "deploy" / "systemd" / "roadgrip-rsu.service", tree / "lib/systemd/system/roadgrip-rsu.service")
    _copy(FILES / "roadgrip-rsu", tree / "usr/bin/roadgrip-rsu", mode=0o755)
    documents = tree / DOCUMENTS
    _copy(FILES / "copyright", documents / "copyright")
    for page in ("install.md", "backup.md", "roadside.md", "monitoring.md"):
        _copy(ROOT / "docs" / page, documents / page)
    for example in ("prometheus.yml", "roadgrip.rules.yml", "roadgrip.dashboard.json"):
        _copy(ROOT / "deploy" / "monitoring" / example, documents / "examples" / example)
    _copy(ROOT / "deploy" / "rsu.example.toml", documents / "examples" / "rsu.example.toml")
    (documents / "settings.md").write_text(settings_table(), encoding="utf-8")
    (documents / "contents.json").write_text(json.dumps(contents, indent=1) + "\n", encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_bytes()
    (documents / "changelog.gz").write_bytes(gzip.compress(changes, mtime=0))


def _copy(source: Path, target: Path, *, mode: int = 0o644) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
    target.chmod(mode)


def _control(tree: Path, processor: Processor, version: str) -> None:
    """Write what dpkg reads."""
    folder = tree / "DEBIAN"
    files = sorted(path for path in tree.rglob("*") if path.is_file() and not path.is_symlink())
    # As dpkg-gencontrol counts: whole kilobytes for files, one for everything else.
    others_count = sum(1 for path in tree.rglob("*") if path.is_symlink() or not path.is_file())
    size_kb = others_count + sum(-(-path.stat().st_size // 1024) for path in files)
    folder.mkdir()
    text = (FILES / "control").read_text(encoding="utf-8")
    text = text.format(
        version=version,
        architecture=processor.architecture,
        installed_size_kb=size_kb,
        python=PYTHON,
        next_python=NEXT_PYTHON,
    )
    (folder / "control").write_text(text, encoding="utf-8")
    (folder / "conffiles").write_text(f"{CONFIGURATION}\n", encoding="utf-8")
    sums = [f"{_md5(path)}  {path.relative_to(tree)}" for path in files]
    (folder / "md5sums").write_text("\n".join(sums) + "\n", encoding="utf-8")
    for name in SCRIPTS:
        _copy(FILES / name, folder / name, mode=0o755)


def _md5(path: Path) -> str:
    """Return what `dpkg --verify` compares."""
    return hashlib.md5(path.read_bytes(), usedforsecurity=False).hexdigest()


def _settle(tree: Path, *, epoch_s: int) -> None:
    """Give all files the modes and the time that do not depend on who built."""
    for path in (tree, *tree.rglob("*")):
        if not path.is_symlink():
            runs = path.is_dir() or path.parent == tree / "usr/bin" or path.name in SCRIPTS
            path.chmod(0o755 if runs else 0o644)
        os.utime(path, (epoch_s, epoch_s), follow_symlinks=False)


def _run(*command: str, environment: Mapping[str, str]) -> None:
    done = subprocess.run(list(command), env=dict(environment), capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BuildError(f"{' '.join(command)}\n{done.stdout}{done.stderr}")


def main() -> int:
    """Return 0 after making the package that the command line asks for."""
    here = next((each for each in PROCESSORS if each.machine == platform.machine()), PROCESSORS[0])
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--arch", choices=[each.architecture for each in PROCESSORS], default=here.architecture, help="as Debian says"
    )
    parser.add_argument("--revision", default="1", help="Debian's part of the version; a higher one is an upgrade")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder for the package")
    given = parser.parse_args()
    if not re.fullmatch(r"[0-9][0-9A-Za-z.+~]*", given.revision):
        parser.error(f"--revision: {given.revision!r} is no revision; write 2, or 2+site1")
    (processor,) = (each for each in PROCESSORS if each.architecture == given.arch)
    try:
        package = build(
            processor, revision=given.revision, out=given.out, work=ROOT / "build" / "deb" / processor.architecture
        )
    except BuildError as error:
        print(f"make deb: {error}", file=sys.stderr)
        return 1
    print(f"{package}: {package.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
