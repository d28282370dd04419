"""Checks of `observe`. Each is named as its function; its docstring is the promise it checks."""

from dataclasses import replace

import torch

from toolkit.alpha import Observation
from toolkit.errors import ToolkitError
from toolkit.testing.case import PARTS, Case, are_equal, each_part, expect
from toolkit.types import LinearImage

BAYER = ((0, 1), (1, 2))
VARIANCE_RATIO = (0.7, 1.4)
"""Scatter seen over variance stated: an estimator may be somewhat careful, hardly careless."""
BORDER = 12
"""px by which pixels around may count."""


def observe_shapes(case: Case) -> None:
    """Signal, ground and variance are [B, Q, H, W] of the picture's size, on its device."""
    seen = case.seen
    expect(isinstance(seen, Observation), f"observe gives a {type(seen).__name__}")
    channels = seen.signal.shape[1] if seen.signal.ndim == 4 else 0
    wanted = [1, channels, case.sample.image.height, case.sample.image.width]
    for part in PARTS:
        shape = list(getattr(seen, part).shape)
        expect(channels and shape == wanted, f"{part} has shape {shape}, not {wanted}")
        device = getattr(seen, part).device
        expect(device == case.sample.image.rgb.device, f"{part} is on {device}")


def observe_finite(case: Case) -> None:
    """Signal and ground are finite; a variance is positive, and infinite off the streak at most."""
    for part in ("signal", "ground"):
        values = getattr(case.seen, part)
        expect(torch.isfinite(values).all(), f"{part} has values that are not finite")
    variance = case.seen.variance
    expect((variance > 0).all(), f"variance goes down to {float(variance.min()):.3g}")
    known = torch.isfinite(variance)[0][:, case.sample.core]
    expect(known.all(), "variance is infinite on the streak, as if nothing had been measured there")


def observe_ground(case: Case) -> None:
    """The ground is that of the background alone: it does not change with the shot."""
    elsewhere = case.observe(image=replace(case.sample.background, frames=1))
    expect(
        are_equal(elsewhere, case.seen, "ground"), "the ground changes where the ball is taken away"
    )


def observe_noise(case: Case) -> None:
    """The variance is that of signal minus ground, as seen when the shot is repeated."""
    many = [case.observe(*pictures) for pictures in case.sample.repeats]
    change = torch.stack([seen.signal - seen.ground for seen in many])
    scatter = change.var(0)
    stated = torch.stack([seen.variance for seen in many]).mean(0)
    ratio = (scatter / stated)[0]
    for place, chosen in (("on the streak", case.sample.core), ("off it", ~case.sample.core)):
        # infinite where nothing is known: the ratio there is 0
        found = float(ratio[:, chosen & torch.isfinite(stated[0]).all(0)].mean())
        low, high = VARIANCE_RATIO
        expect(
            low <= found <= high,
            f"{place} the scatter seen is {found:.2f} of the variance stated; it must lie within"
            f" {low} and {high}",
        )


def observe_raw(case: Case) -> None:
    """A RAW shot is observed too; where a channel was not measured its variance is infinite."""
    sample = case.sample
    shot, ground = (_mosaic(picture) for picture in (sample.image, sample.background))
    noise = replace(sample.noise, density=torch.tensor([0.25, 0.5, 0.25]))
    seen = case.estimator.observe(shot, ground, noise)
    for part in PARTS:
        shape = list(getattr(seen, part).shape[-2:])
        expect(shape == [shot.height, shot.width], f"{part} has shape {shape}")
    expect(torch.isfinite(seen.signal).all(), "signals behind a mosaic are not finite")
    expect(torch.isfinite(seen.ground).all(), "grounds behind a mosaic are not finite")
    expect((seen.variance > 0).all(), "variances behind a mosaic are not all positive")
    known = torch.isfinite(seen.variance).any(1, keepdim=True).float()
    cells = torch.nn.functional.max_pool2d(known, 2)
    expect((cells > 0).all(), "there are cells of the mosaic of which nothing is known")


def observe_bad_pixels(case: Case) -> None:
    """A white pixel changes only what is near; a NaN stays NaN, and becomes no measurement."""
    y, x = (side // 2 for side in case.sample.alpha.shape)
    white = case.observe(image=_with_pixel(case.sample.image, y, x, 1.0))
    far = torch.ones_like(case.sample.core)
    far[y - BORDER : y + BORDER + 1, x - BORDER : x + BORDER + 1] = False
    for part in PARTS:
        values = getattr(white, part)
        is_kept = ~torch.isnan(values) if part == "variance" else torch.isfinite(values)
        expect(is_kept.all(), f"{part} is no number where a pixel is white")
        same = torch.isclose(values, getattr(case.seen, part), rtol=1e-4, atol=1e-6)
        expect(same[0][:, far].all(), f"{part} changes far from a white pixel")
    try:
        bad = case.observe(image=_with_pixel(case.sample.image, y, x, torch.nan))
    except ToolkitError:  # the picture is refused: nothing is hidden
        return
    hidden = torch.isfinite(bad.signal) & torch.isfinite(bad.variance)
    expect(not hidden[0, :, y, x].any(), "a NaN in the shot becomes a signal like any other")


def observe_input_unchanged(case: Case) -> None:
    """Pictures and noise model are left as they were, bit by bit."""
    sample = case.sample
    noise = sample.noise
    watched = {
        "shot": sample.image.rgb,
        "background": sample.background.rgb,
        "mask of clipped pixels": sample.image.clipped,
        "read variance": noise.read_variance,
        "gain": noise.gain,
    }
    before = {name: values.clone() for name, values in watched.items()}
    try:
        case.observe()
        changed = [name for name in watched if not torch.equal(watched[name], before[name])]
    finally:
        for name, values in watched.items():
            values.copy_(before[name])  # the sample serves other checks
    expect(not changed, f"observe changes the {', '.join(changed)} it is given")


def observe_batch(case: Case) -> None:
    """Two pictures observed together give what each gives alone."""
    (first, ground), (second, other) = case.sample.repeats[:2]
    # half as bright: what is shared between the pictures shows
    second = replace(second, rgb=second.rgb / 2)
    together = case.observe(_stacked(first, second), _stacked(ground, other))
    alone = [case.observe(first, ground), case.observe(second, other)]
    for number, seen in enumerate(alone):
        own = Observation(**{part: getattr(together, part)[number, None] for part in PARTS})
        each_part(
            lambda part, own=own, seen=seen: are_equal(own, seen, part),  # type: ignore[misc]
            "of a picture changes when another is observed with it",
        )


def observe_window(case: Case) -> None:
    """A window of the picture gives the window of the answer, but for its border."""
    image, background = case.sample.image, case.sample.background
    left, top, width, height = 40, 52, image.width - 90, image.height - 80
    own = case.observe(
        image.window(left, top, width, height), background.window(left, top, width, height)
    )
    whole = slice(top + BORDER, top + height - BORDER), slice(left + BORDER, left + width - BORDER)
    inner = slice(BORDER, height - BORDER), slice(BORDER, width - BORDER)
    cut = Observation(**{part: getattr(case.seen, part)[..., *whole] for part in PARTS})
    seen = Observation(**{part: getattr(own, part)[..., *inner] for part in PARTS})
    each_part(
        lambda part: are_equal(seen, cut, part), "of a window is not the window of the picture's"
    )


def _mosaic(picture: LinearImage) -> LinearImage:
    """Give what a sensor behind a Bayer pattern records of a picture."""
    period = torch.tensor(BAYER)
    rows, columns = torch.arange(picture.height) % 2, torch.arange(picture.width) % 2
    channel = period[rows[:, None], columns[None, :]]
    mosaic = picture.rgb.gather(1, channel[None, None])
    return replace(picture, rgb=None, mosaic=mosaic, pattern=BAYER)


def _with_pixel(picture: LinearImage, y: int, x: int, value: float) -> LinearImage:
    rgb, clipped = picture.rgb.clone(), picture.clipped.clone()
    rgb[..., y, x], clipped[..., y, x] = value, True
    return replace(picture, rgb=rgb, clipped=clipped)


def _stacked(first: LinearImage, second: LinearImage) -> LinearImage:
    return replace(
        first,
        rgb=torch.cat([first.rgb, second.rgb]),
        clipped=torch.cat([first.clipped, second.clipped]),
        exposure=None,
    )
