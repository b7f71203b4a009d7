"""Grip: which friction explains how the car steered, moved and turned its wheels, by a model of its two axles.

Passage by passage in this order: `motion` (what was sensed, sampled coarsely), `forces` (what that asks of the axles),
`axle` (slip that an axle needs for its force, at every friction at once), `channels` (what each friction predicts, and
by how much it misses), `likelihood` (how well each friction explains a channel), `evidence` (all of it as the figures
that are sent).
"""
