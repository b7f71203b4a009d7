import json
import re

from roadgrip.records import AdvisoryReason, Confidence, NotCounted
from rsu_app.adapters.http.models import IntervalModel, RefinedModel
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


def test_the_interval_on_the_page_has_every_field(project_root):
    [example] = re.findall(r"```json\n(\{\"mu_low\".*?)```", page(project_root), re.DOTALL)
    shown = json.loads(example)
    assert shown.keys() == IntervalModel.model_fields.keys()
    assert shown["refined"].keys() == RefinedModel.model_fields.keys()
    assert IntervalModel.model_validate(shown).refined.mu_low == shown["refined"]["mu_low"]


def test_every_code_of_an_answer_is_explained(project_root):
    text = page(project_root) + (project_root / "docs/friction-interval.md").read_text(encoding="utf-8")
    codes = {*(reason.value for reason in AdvisoryReason), *(confidence.value for confidence in Confidence)}
    codes |= {(flag.name or "").lower() for flag in NotCounted if flag}
    assert {code for code in codes if f"`{code}`" not in text} == set()
    told = set(re.findall(r"`(winter_speed_\w+)`", text)) - {"winter_speed_mps"}
    assert told <= codes
