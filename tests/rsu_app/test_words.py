import pytest

from rsu_app.words import duration_words, size_words


@pytest.mark.parametrize(
    ("size_bytes", "words"), [(0, "0 B"), (2048, "2.0 kB"), (150 * 1024**2, "150 MB"), (7.5 * 1024**3, "7.5 GB")]
)
def test_sizes_are_said_as_people_say_them(size_bytes, words):
    assert size_words(size_bytes) == words


@pytest.mark.parametrize(
    ("duration_s", "words"), [(0.4, "0 s"), (150.0, "2 min"), (7_500.0, "2 h 5 min"), (200_000.0, "2 d 7 h")]
)
def test_durations_are_said_as_people_say_them(duration_s, words):
    assert duration_words(duration_s) == words
    assert duration_words(-duration_s) == f"-{words}"
