"""Checks of `foreground`. Each is named as its function; its docstring is the promise."""

from dataclasses import replace

import torch
from torch import Tensor

from toolkit.alpha import Chord
from toolkit.testing.case import Case, are_close, chords, expect

STEP = 1e-3
SLOPE_ERROR = 0.02
"""Of the largest slope and value: a difference quotient errs where a table bends."""
HALVES_ERROR = 0.02


def foreground_shapes(case: Case) -> None:
    """The answer is [..., S, Q] for every shape of the offsets, with the Q of observe."""
    channels = case.seen.signal.shape[1]
    for shape in ((7,), (1,), (3, 7), (3, 1), (2, 3, 7)):
        offset = torch.linspace(-0.9, 0.9, 7)[: shape[-1]].expand(shape)
        for direction in (torch.zeros(*shape[:-1], 1), torch.zeros(1)):
            found = case.foreground(Chord(offset=offset, direction=direction))
            text = f"for offsets {list(shape)} the answer is {list(found.shape)}"
            expect(found.shape == (*shape, channels), text)


def foreground_order(case: Case) -> None:
    """Every chord is answered for itself: other orders and neighbours change nothing."""
    chord = chords()
    whole = case.foreground(chord)
    turned = Chord(offset=chord.offset.flip(0, 1), direction=chord.direction.flip(0))
    expect(
        are_close(case.foreground(turned).flip(0, 1), whole),
        "chords in another order get other answers",
    )
    one = Chord(offset=chord.offset[2:3, 4:5], direction=chord.direction[2:3])
    expect(are_close(case.foreground(one), whole[2:3, 4:5]), "a chord alone gets another answer")


def foreground_parts(case: Case) -> None:
    """Partial chords and the rim are finite, and the halves of a chord average to the whole."""
    chord = chords()
    rim = replace(chord, offset=torch.tensor([-1.0, 0.0, 1.0]).repeat(6, 1))
    expect(torch.isfinite(case.foreground(rim)).all(), "values at the rim are not finite")
    slope = case.slope(rim)[1]
    expect(slope is None or torch.isfinite(slope).all(), "slopes at the rim are not finite")
    for start, stop in ((-1.0, -0.7), (-0.2, 0.5), (0.999, 1.0), (0.3, 0.3)):
        part = case.foreground(replace(chord, start=start, stop=stop))
        text = f"the part from {start} to {stop}"
        expect(torch.isfinite(part).all(), f"{text} is not finite")
        ends = (torch.full_like(chord.offset, end) for end in (start, stop))
        same = case.foreground(replace(chord, **dict(zip(("start", "stop"), ends, strict=True))))
        expect(are_close(part, same, 1e-3), f"{text} differs when its ends are tensors")
    whole = case.foreground(chord)
    halves = [case.foreground(replace(chord, start=a, stop=a + 1)) for a in (-1.0, 0.0)]
    error = float(((halves[0] + halves[1]) / 2 - whole).abs().max())
    limit = HALVES_ERROR * float(whole.abs().max())
    expect(error <= limit, f"the halves of a chord miss the whole by {error:.3g}")


def foreground_slope(case: Case) -> None:
    """The slope is the derivative in the offset, and None only where that is zero."""
    chord = chords(samples=23, dtype=torch.float64)
    value, slope = case.slope(chord)
    expect(are_close(value, case.foreground(chord)), "value and foreground differ")
    ahead, behind = (
        case.foreground(replace(chord, offset=chord.offset + step)) for step in (STEP, -STEP)
    )
    quotient = (ahead - behind) / (2 * STEP)
    scale = float(quotient.abs().max()) + float(value.abs().max())
    given = torch.zeros_like(quotient) if slope is None else slope
    expect(given.shape == value.shape, f"the slope has shape {list(given.shape)}")
    error = float((given - quotient).abs().max())
    expect(
        error <= SLOPE_ERROR * scale,
        f"the slope misses the difference quotient by {error:.3g}, {scale:.3g} being the scale",
    )


def foreground_appearance(case: Case) -> None:
    """The answer is linear in the unknowns; where there are none, it needs none."""
    count, chord = case.estimator.unknowns(), chords()
    expect(
        isinstance(count, int) and count >= 0, f"unknowns gives {count!r}, not a number from 0 up"
    )
    if count == 0:
        found = case.estimator.foreground(chord, None)
        expect(torch.isfinite(found).all(), "without unknowns the answer is not finite")
        return

    def answer(values: Tensor) -> Tensor:
        return case.estimator.foreground(chord, values)

    first, second = torch.linspace(0.2, 0.7, count), torch.linspace(0.5, 0.1, count)
    mixed = answer(0.3 * first + 0.7 * second)
    expect(
        are_close(mixed, 0.3 * answer(first) + 0.7 * answer(second)),
        "a mixture of unknowns is not answered by the mixture of the answers",
    )
