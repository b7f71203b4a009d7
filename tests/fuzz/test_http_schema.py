"""Requests made from the unit's own OpenAPI document: every answer is one that the document promises."""

import os

import schemathesis
from hypothesis import HealthCheck, settings
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from rsu_app.adapters.http.frames import FRAMES_MEDIA_TYPE
from tests.rsu_app.sites import make_unit

EXAMPLES_COUNT = int(os.environ.get("ROADGRIP_TESTS_HTTP_EXAMPLES", "12"))
"""For each route; `make fuzz` asks for more."""
PROMISES = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]


def _schema():
    found = schemathesis.openapi.from_asgi("/openapi.json", make_unit().app)
    # A stream of events ends with the listener, who here would never leave.
    return found.exclude(path_regex="/stream$")


@schemathesis.serializer(FRAMES_MEDIA_TYPE)
def _as_it_is(_context, value):
    return value if isinstance(value, bytes) else str(value).encode()


schema = _schema()


@schema.parametrize()
@settings(max_examples=EXAMPLES_COUNT, suppress_health_check=list(HealthCheck))
def test_every_answer_is_one_that_the_document_promises(case):
    case.call_and_validate(checks=PROMISES)
