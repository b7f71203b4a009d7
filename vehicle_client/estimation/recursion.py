"""A recursion that feeds its own result back, computed for many stretches of time at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

BLOCK_STEPS_COUNT = 20
"""Steps that one block takes; about the fastest for passages of 10 s to some minutes."""


def recursion_states(
    transition: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    addend: tuple[FloatArray, FloatArray],
    *,
    start: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """Return all states of x[k + 1] = M[k] x[k] + c[k], the start first. Both (n + 1,)

    The same as step after step but for rounding: a state is affine in the state some steps before, so blocks of steps
    are composed side by side, chained from start to end, and then filled in. Meant for recursions that forget; one
    that grows does so here as well. A NaN spreads to all later states and to none before.

    Args:
        transition: M by rows: m00, m01, m10, m11. Each (n,)
        addend: c. Each (n,)
        start: The first state.

    References:
        Blelloch, Prefix sums and their applications, section "Recurrence equations".
    """
    count = len(addend[0])
    blocks_count = max(1, -(-count // BLOCK_STEPS_COUNT))
    padded = np.zeros((6, blocks_count * BLOCK_STEPS_COUNT))
    for row, values in zip(padded, (*transition, *addend), strict=True):
        row[:count] = values
    # From (which, block, step) to (step, which, block): a step of all blocks lies together.
    m00_m01_m10_m11_c = np.ascontiguousarray(padded.reshape(6, blocks_count, BLOCK_STEPS_COUNT).transpose(2, 0, 1))
    from_x = m00_m01_m10_m11_c[:, 0:4:2, None, :]
    from_y = m00_m01_m10_m11_c[:, 1:4:2, None, :]
    constant = m00_m01_m10_m11_c[:, 4:6, :]
    # [x, y] after each step is composed[:, :2] @ [x, y] before the block + composed[:, 2].
    composed = np.empty((BLOCK_STEPS_COUNT, 2, 3, blocks_count))
    composed[0, :, 0], composed[0, :, 1], composed[0, :, 2] = from_x[0, :, 0], from_y[0, :, 0], constant[0]
    summand = np.empty((2, 3, blocks_count))
    for step in range(1, BLOCK_STEPS_COUNT):
        before, after = composed[step - 1], composed[step]
        np.multiply(from_x[step], before[0], out=after)
        np.multiply(from_y[step], before[1], out=summand)
        after += summand
        after[:, 2] += constant[step]
    x, y = start
    starts = [(x, y)]
    # Python floats: a recursion over numpy scalars is some five times slower.
    for p00, p01, q0, p10, p11, q1 in composed[-1, :, :, :-1].reshape(6, -1).T.tolist():
        x, y = p00 * x + p01 * y + q0, p10 * x + p11 * y + q1
        starts.append((x, y))
    at_start = np.array(starts).T
    states = composed[:, :, 0] * at_start[0] + composed[:, :, 1] * at_start[1] + composed[:, :, 2]
    in_order = states.transpose(1, 2, 0).reshape(2, -1)[:, :count]
    return np.concatenate([[start[0]], in_order[0]]), np.concatenate([[start[1]], in_order[1]])
