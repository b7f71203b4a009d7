"""A reader of PromQL that knows enough to tell which metrics and labels a query names, and whether its brackets fit."""

from __future__ import annotations

import re
from dataclasses import dataclass

_TOKEN = re.compile(
    r"""\s*(?:
    (?P<string>"(?:[^"\\]|\\.)*")
    | (?P<span>\d+(?:ms|[smhdwy]))
    | (?P<number>\d+\.?\d*(?:e[+-]?\d+)?)
    | (?P<variable>\$\w+)
    | (?P<word>[a-zA-Z_:][\w:]*)
    | (?P<sign>=~|!~|!=|<=|>=|==|[-+*/%^<>=(){}\[\],])
    )""",
    re.VERBOSE,
)
_GROUPING = {"by", "without", "on", "ignoring", "group_left", "group_right"}
_WORDS = {"and", "or", "unless", "offset", "bool"}
FUNCTIONS = set(
    """sum min max avg count rate increase delta changes histogram_quantile min_over_time max_over_time avg_over_time
    absent clamp_max time""".split()
)
_PAIRS = {")": "(", "}": "{", "]": "["}


class PromqlError(ValueError):
    """What is no query."""


@dataclass(frozen=True)
class Selector:
    """A metric and the labels it is selected by."""

    metric: str
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Query:
    """What a query names.

    Attributes:
        selectors: The series it reads.
        grouped: Labels it groups or joins by.
    """

    selectors: tuple[Selector, ...]
    grouped: frozenset[str]


def tokens_of(text: str) -> list[str]:
    found, place = [], 0
    while text[place:].strip():
        match = _TOKEN.match(text, place)
        if match is None:
            raise PromqlError(f"what is {text[place:].strip()[:20]!r} in {text!r}?")
        found.append(match[0].strip())
        place = match.end()
    return found


def read(text: str) -> Query:
    """Return what a query names; raise if it is none."""
    tokens = tokens_of(text)
    _check_brackets(tokens, text)
    selectors: list[Selector] = []
    grouped: set[str] = set()
    place = 0
    while place < len(tokens):
        token, following = tokens[place], tokens[place + 1] if place + 1 < len(tokens) else ""
        if token in _GROUPING and following == "(":
            end = tokens.index(")", place)
            grouped |= {label for label in tokens[place + 2 : end] if label != ","}
            place = end
        elif re.fullmatch(r"[a-zA-Z_:][\w:]*", token) and token not in _WORDS:
            if token in FUNCTIONS:
                if following != "(" and following not in _GROUPING:
                    raise PromqlError(f"{token} without its arguments in {text!r}")
            elif following == "(":
                raise PromqlError(f"there is no function {token} in {text!r}")
            else:
                labels: tuple[str, ...] = ()
                if following == "{":
                    end = tokens.index("}", place)
                    labels = _labels(tokens[place + 2 : end], text)
                    place = end
                selectors.append(Selector(token, labels))
        place += 1
    if not selectors:
        raise PromqlError(f"{text!r} reads nothing")
    return Query(tuple(selectors), frozenset(grouped))


def _labels(tokens: list[str], text: str) -> tuple[str, ...]:
    names = []
    for i in range(0, len(tokens), 4):
        part = tokens[i : i + 4]
        if len(part) < 3 or part[1] not in {"=", "!=", "=~", "!~"} or not part[2].startswith('"') or part[3:] > [","]:
            raise PromqlError(f"{' '.join(part)} selects nothing in {text!r}")
        names.append(part[0])
    return tuple(names)


def _check_brackets(tokens: list[str], text: str) -> None:
    open_ones: list[str] = []
    for token in tokens:
        if token in _PAIRS.values():
            open_ones.append(token)
        elif token in _PAIRS and (not open_ones or open_ones.pop() != _PAIRS[token]):
            raise PromqlError(f"{token} closes nothing in {text!r}")
    if open_ones:
        raise PromqlError(f"{open_ones[-1]} stays open in {text!r}")
