"""Whether traffic is still what a bundle was trained on, from the exports of many units."""
