import re

from rsu_app.adapters.http.problems import STATUS_OF_REASON
from tests.rsu_app.sites import make_unit


def page(project_root) -> str:
    text: str = (project_root / "docs/http-api.md").read_text(encoding="utf-8")
    return text


def test_every_call_is_on_the_page(project_root):
    calls = {
        f"{method.upper()} {path}" for path, methods in make_unit().app.openapi()["paths"].items() for method in methods
    }
    told = set(re.findall(r"`((?:GET|POST) /[^`]*)`", page(project_root)))
    assert calls <= told


def test_every_reason_is_on_the_page_with_its_status(project_root):
    rows = dict(re.findall(r"^\| `(\w+)` \| (\d{3}) \|", page(project_root), re.MULTILINE))
    assert rows == {reason.value: str(status.value) for reason, status in STATUS_OF_REASON.items()}
