"""Refusals on HTTP: the one table from reason code to status, and problem documents (RFC 9457).

A receipt is always a receipt: `POST /v1/sections/{id}/passages` answers a refused passage with the reason in a problem
document; the status only helps those that look at nothing else.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import Response
from pydantic import BaseModel, ConfigDict, Field

from roadgrip.reasons import Reason

PROBLEM_MEDIA_TYPE = "application/problem+json"
RETRY_AFTER_S = 5

STATUS_OF_REASON: dict[Reason, HTTPStatus] = {
    # Not a message: whatever is sent again will be refused again.
    Reason.MALFORMED: HTTPStatus.UNPROCESSABLE_ENTITY,
    Reason.OVERSIZED: HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
    Reason.BAD_CHECKSUM: HTTPStatus.UNPROCESSABLE_ENTITY,
    Reason.UNSUPPORTED_VERSION: HTTPStatus.UNPROCESSABLE_ENTITY,
    # Nobody we trust.
    Reason.UNSIGNED: HTTPStatus.FORBIDDEN,
    Reason.BAD_SIGNATURE: HTTPStatus.FORBIDDEN,
    Reason.UNKNOWN_KEY: HTTPStatus.FORBIDDEN,
    Reason.CERTIFICATE_EXPIRED: HTTPStatus.FORBIDDEN,
    Reason.CERTIFICATE_REVOKED: HTTPStatus.FORBIDDEN,
    Reason.NOT_PERMITTED: HTTPStatus.FORBIDDEN,
    Reason.OUTSIDE_REPLAY_WINDOW: HTTPStatus.FORBIDDEN,
    # Not ours, or no longer.
    Reason.UNKNOWN_SECTION: HTTPStatus.NOT_FOUND,
    Reason.STALE_MAP: HTTPStatus.CONFLICT,
    Reason.WRONG_FEATURE_TABLE: HTTPStatus.CONFLICT,
    # A passage that cannot be.
    Reason.NOT_FINITE: HTTPStatus.UNPROCESSABLE_ENTITY,
    Reason.OUT_OF_RANGE: HTTPStatus.UNPROCESSABLE_ENTITY,
    Reason.IMPOSSIBLE_AGE: HTTPStatus.UNPROCESSABLE_ENTITY,
    Reason.IMPOSSIBLE_DURATION: HTTPStatus.UNPROCESSABLE_ENTITY,
    Reason.PASSAGE_ID_REUSED: HTTPStatus.CONFLICT,
    Reason.REPLAYED: HTTPStatus.CONFLICT,
    # Not now.
    Reason.BUDGET_EXHAUSTED: HTTPStatus.TOO_MANY_REQUESTS,
    Reason.RATE_LIMITED: HTTPStatus.TOO_MANY_REQUESTS,
    Reason.BUSY: HTTPStatus.SERVICE_UNAVAILABLE,
    Reason.NO_MODEL: HTTPStatus.SERVICE_UNAVAILABLE,
    Reason.STORE_UNAVAILABLE: HTTPStatus.SERVICE_UNAVAILABLE,
    # What a vehicle keeps to itself; a unit that is told so anyway takes it as a passage that cannot be.
    Reason.TOO_SHORT: HTTPStatus.UNPROCESSABLE_ENTITY,
    Reason.TOO_MANY_GAPS: HTTPStatus.UNPROCESSABLE_ENTITY,
    Reason.TOO_SLOW: HTTPStatus.UNPROCESSABLE_ENTITY,
    Reason.WRONG_ROAD: HTTPStatus.UNPROCESSABLE_ENTITY,
    Reason.PASSAGE_ABORTED: HTTPStatus.UNPROCESSABLE_ENTITY,
    Reason.SENSOR_FAULT: HTTPStatus.UNPROCESSABLE_ENTITY,
}
"""Every reason code has its status; a test asserts it."""


class Problem(BaseModel):
    """What is sent instead of an answer (RFC 9457), with our reason code."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "type": "about:blank",
                    "title": "Conflict",
                    "status": 409,
                    "reason": "stale_map",
                    "detail": "the passage was cut with map 0123456789abcdef, the unit has fedcba9876543210",
                    "may_retry": False,
                }
            ]
        }
    )

    type: str = Field(default="about:blank", description="Nothing beyond the status: `reason` says it all.")
    title: str = Field(description="Name of the HTTP status.")
    status: int = Field(description="The HTTP status.")
    reason: str = Field(description="The code to act on; the metric counts it under the same name.")
    detail: str = Field(description="For a person; never needed to act.")
    may_retry: bool = Field(description="Whether the same request may be accepted later without change.")


class ProblemError(Exception):
    """Leaves a route early with a problem document."""

    def __init__(
        self,
        reason: str,
        status: HTTPStatus,
        detail: str,
        *,
        may_retry: bool = False,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        """Keep what the document will say."""
        super().__init__(detail)
        self.reason = reason
        self.status = status
        self.detail = detail
        self.may_retry = may_retry
        self.headers = dict(headers or {})


def refusal(reason: Reason, detail: str) -> ProblemError:
    """Return the error for a reason code, with the status of the table."""
    return ProblemError(reason.value, STATUS_OF_REASON[reason], detail, may_retry=reason.may_retry)


def problem_response(error: ProblemError) -> Response:
    """Return the problem document as a response."""
    document = Problem(
        title=error.status.phrase,
        status=error.status.value,
        reason=error.reason,
        detail=error.detail[:500],
        may_retry=error.may_retry,
    )
    headers = error.headers | ({"Retry-After": str(RETRY_AFTER_S)} if error.may_retry else {})
    return Response(
        json.dumps(document.model_dump()), status_code=error.status, media_type=PROBLEM_MEDIA_TYPE, headers=headers
    )


def documented(*statuses: HTTPStatus) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI entries that say which problems a route may answer."""
    schema = {"$ref": "#/components/schemas/Problem"}
    return {
        s.value: {"description": s.phrase, "model": Problem, "content": {PROBLEM_MEDIA_TYPE: {"schema": schema}}}
        for s in sorted(set(statuses))
    }
