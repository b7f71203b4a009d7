"""The colours of the reports: told apart by people who see few of them, and in print."""

PALETTE = ("#1f5fa8", "#c65a11", "#2e8b57", "#8e44ad", "#b8860b", "#c0392b", "#16808a", "#7f5539", "#555555", "#d16ba5")
"""In the order in which they are taken."""
GREY = "#555555"


def palette_colour(index: int) -> str:
    """Return the colour of the n-th thing in a picture."""
    return PALETTE[index % len(PALETTE)]


def faint(colour: str, alpha_frac: float) -> str:
    """Return a colour of the palette, seen through, as browsers write it."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{alpha_frac:g})"
