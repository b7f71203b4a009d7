"""The gate: judges a bundle that wants to take the place of another, on drives that neither learned from.

`training.gate.judge` asks everything, `training.gate.verdict` holds what was said, `training.gate.thresholds` what is
asked at least; docs/gate.md says why.
"""
