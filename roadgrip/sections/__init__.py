"""The sections that come with roadgrip (the paper's three roads), and the one place where a section file is read.

Both ends of the air name a section the same way: by the name of a packaged one, or by the path of a file.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from roadgrip.errors import SectionError
from roadgrip.section import RoadSection
from roadgrip.section_file import section_from_json


def packaged_names() -> tuple[str, ...]:
    """Return the names of the sections that come with the distribution."""
    names = (entry.name for entry in files(__name__).iterdir())
    return tuple(sorted(name.removesuffix(".json") for name in names if name.endswith(".json")))


def read_section(place: str | Path) -> RoadSection:
    """Return the section that the name of a packaged one, or the path of a section file, leads to.

    Raises:
        SectionError: There is none, or it cannot be used; the message names the place.
    """
    text = str(place)
    if text in packaged_names():
        return section_from_json((files(__name__) / f"{text}.json").read_text(encoding="utf-8"))
    path = Path(place)
    if not path.exists():
        packaged = ", ".join(packaged_names())
        raise SectionError(f"no section {text!r}; packaged are {packaged}, anything else is the path of a .json file")
    try:
        return section_from_json(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SectionError(f"cannot read {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise SectionError(f"{path}: section file: not UTF-8 text (byte {error.start}); is it compressed?") from error
    except SectionError as error:
        raise SectionError(f"{path}: {error}") from error
