"""One encoding for each value: what the strict dialect reads, and what it refuses however deep it lies."""

import pytest

from roadgrip.cbor import strict_dumps, strict_loads
from roadgrip.errors import WireError
from roadgrip.reasons import Reason

OURS = {
    "number": "19 03e8",
    "text": "63 616263",
    "map": "a3 00 01 20 02 3a 00011170 03",
    "array in a map": "a1 00 82 01 02",
}
OTHERS = {
    "a float in its longest spelling": "fb 3ff0000000000000",
    "a float in its shortest spelling": "f9 3c00",
    "yes": "f5",
    "nothing": "f6",
    "a simple value": "e0",
    "a number in a longer spelling": "18 01",
    "an array without an end": "9f 01 ff",
    "keys out of order": "a2 02 00 01 00",
    "keys that old and new canonical order sort differently": "a2 18 18 00 20 00",
    "those, the other way round": "a2 20 00 18 18 00",
    "a text as a key": "a1 61 61 00",
    "a key given twice": "a2 01 00 01 00",
}
PLACES = {
    "alone": "",
    "in an array": "81",
    "in a map": "a1 00",
    "under a tag": "d2",
    "in an array under a tag": "d2 81",
    "under a tag under a tag": "d2 d2",
}
"""Maps and arrays under two tags come as kinds of their own, which cannot be changed."""


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
@pytest.mark.parametrize("value", OURS.values(), ids=OURS)
def test_what_messages_are_made_of_is_read_and_written_as_it_was(value, place):
    data = bytes.fromhex(place + value)
    assert strict_dumps(strict_loads(data)) == data


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
@pytest.mark.parametrize("value", OTHERS.values(), ids=OTHERS)
def test_another_spelling_or_kind_of_value_is_refused(value, place):
    with pytest.raises(WireError) as refused:
        strict_loads(bytes.fromhex(place + value))
    assert refused.value.reason is Reason.MALFORMED
