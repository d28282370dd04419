"""Each check catches the fault it is for: one deliberately wrong estimator a check."""

import random
import re
import time
from dataclasses import dataclass, replace

import pytest
import torch

from toolkit import AlphaEstimator, ConfigError, Observation
from toolkit.testing import check_estimator, check_names, make_sample

COLOUR = (0.75, 0.4, 0.1)


@dataclass(frozen=True, kw_only=True)
class Good(AlphaEstimator):
    """A ball of one colour; each wrong estimator changes one thing about it."""

    colour: tuple[float, float, float] = COLOUR

    def __post_init__(self):
        if not all(0 <= part <= 4 for part in self.colour):
            raise ConfigError(f"colour {self.colour} is not three numbers from 0 to 4")

    def observe(self, image, background, noise):
        measured = image.measured()
        variance = (
            noise.variance(image.rgb, measured)
            + noise.variance(background.rgb, measured) / background.frames
        )
        return Observation(signal=image.rgb, ground=background.rgb, variance=variance)

    def foreground(self, chord, appearance):
        return chord.offset.new_tensor(self.colour).expand(*chord.offset.shape, 3)


def seen_otherwise(change):
    """An estimator whose observation is changed; change(observation, image) -> parts."""

    def observe(self, image, background, noise):
        seen = Good.observe(self, image, background, noise)
        return replace(seen, **change(seen, image))

    return wrong(observe=observe)


def shown_otherwise(change):
    """An estimator whose foreground is changed; change(value, chord) -> value."""
    return wrong(foreground=lambda self, chord, a: change(Good.foreground(self, chord, a), chord))


def wrong(**members):
    return dataclass(frozen=True, kw_only=True)(type("Wrong", (Good,), members))()


def spoil_pictures(seen, image):
    image.rgb[..., 0, 0] += 0.25
    return {}


def hide(seen, image):
    return {"signal": seen.signal.nan_to_num(0.3), "variance": seen.variance.nan_to_num(1e-4)}


def use_threads(value, chord):
    torch.set_num_threads(torch.get_num_threads() + 1)
    return value


def reseed(value, chord):
    torch.manual_seed(0)
    return value


def hog(seen, image):
    torch.empty(30_000_000)
    return {}


def dawdle(value, chord):
    time.sleep(0.15)
    return value


@dataclass(frozen=True, kw_only=True)
class Doubling(Good):
    gain: float = 1.0

    def __post_init__(self):
        object.__setattr__(self, "gain", 2 * abs(self.gain))
        if self.gain != self.gain:
            raise ConfigError("gain is no number")


@dataclass(frozen=True, kw_only=True)
class Careless(Good):
    gloss: float = 0.5


@dataclass(frozen=True, kw_only=True)
class Fussy(Good):
    gloss: float = 0.5

    def __post_init__(self):
        Good.__post_init__(self)
        if not self.gloss < 1:
            raise ValueError("gloss")


@dataclass(frozen=True, kw_only=True)
class Crooked(Good):
    """Its answer grows with the square of its unknown."""

    def unknowns(self):
        return 1

    def foreground(self, chord, appearance):
        brightness = torch.ones(1) if appearance is None else appearance
        return Good.foreground(self, chord, None) * brightness**2


@dataclass(frozen=True, kw_only=True)
class Sloping(Good):
    """Brighter to the right; its own slope has the wrong sign."""

    def foreground(self, chord, appearance):
        return Good.foreground(self, chord, None) * (1 + 0.3 * chord.offset[..., None])

    def foreground_and_slope(self, chord, appearance=None):
        value, slope = AlphaEstimator.foreground_and_slope(self, chord, appearance)
        return value, -slope


WRONG = {
    "observe-shapes": seen_otherwise(lambda seen, _: {"variance": seen.variance[:, :1]}),
    "observe-finite": seen_otherwise(lambda seen, _: {"signal": (seen.signal - 0.3).sqrt()}),
    "observe-ground": seen_otherwise(lambda seen, i: {"ground": 0.5 * (seen.ground + i.rgb)}),
    "observe-noise": seen_otherwise(lambda seen, _: {"variance": seen.variance / 2}),
    "observe-raw": seen_otherwise(
        lambda seen, i: {"variance": seen.variance * (0 if i.mosaic is not None else 1)}
    ),
    "observe-bad-pixels": seen_otherwise(hide),
    "observe-input-unchanged": seen_otherwise(spoil_pictures),
    "observe-batch": seen_otherwise(
        lambda seen, _: {"signal": seen.signal / seen.signal.mean(0, keepdim=True) * 0.3}
    ),
    "observe-window": seen_otherwise(
        lambda seen, _: {"signal": seen.signal - seen.signal.mean((-1, -2), keepdim=True)}
    ),
    "foreground-shapes": shown_otherwise(lambda value, _: value[..., :1]),
    "foreground-order": shown_otherwise(
        lambda value, chord: value * chord.offset.argsort()[..., None]
    ),
    "foreground-parts": shown_otherwise(lambda value, chord: value * (chord.stop - chord.start)),
    "foreground-slope": Sloping(),
    "foreground-appearance": Crooked(),
    "truth-alpha": Good(colour=(0.9, 0.5, 0.15)),
    "truth-variance": seen_otherwise(lambda seen, _: {"variance": seen.variance * 2}),
    "truth-measure": seen_otherwise(lambda seen, _: {"signal": seen.signal.roll(8, -1)}),
    "precision-kept": shown_otherwise(lambda value, _: value.double()),
    "repeatable": seen_otherwise(lambda seen, _: {"ground": seen.ground + random.random() / 1e4}),
    "threads-kept": shown_otherwise(use_threads),
    "state-kept": shown_otherwise(reseed),
    "options-round-trip": Doubling(),
    "options-refused": Careless(),
    "cost": seen_otherwise(hog),
}


@pytest.fixture(scope="module")
def sample():
    return make_sample()


def test_there_is_one_for_each_check():
    assert tuple(WRONG) == check_names()


def test_the_good_one_fails_nothing(sample):
    report = check_estimator(Good(), sample=sample)
    assert report.failed == ()
    assert report.ran == 24


@pytest.mark.parametrize("name", WRONG)
def test_its_own_fault_is_caught(sample, name):
    (result,) = (
        r
        for r in check_estimator(WRONG[name], sample=sample, only=[name]).results
        if r.name == name
    )
    assert result.status == "failed"
    assert result.detail
    assert "\n" not in result.detail


@pytest.mark.parametrize(
    ("estimator", "name", "detail"),
    [
        (shown_otherwise(dawdle), "cost", "foreground takes 0.1.* s; 0.1"),
        (Fussy(), "options-refused", "gloss = nan breaks with ValueError; raise ConfigError"),
        (Careless(), "options-refused", "gloss = nan is accepted"),
        (seen_otherwise(hog), "cost", "observe takes 120 MB at once"),
        (seen_otherwise(spoil_pictures), "observe-input-unchanged", "changes the shot it is given"),
        (shown_otherwise(reseed), "state-kept", "torch's random numbers"),
        (wrong(observe=lambda *_: 1 / 0), "observe-shapes", "breaks with ZeroDivisionError"),
    ],
)
def test_the_detail_says_what_is_wrong(sample, estimator, name, detail):
    report = check_estimator(estimator, sample=sample, only=[name])
    (result,) = (r for r in report.results if r.name == name)
    assert result.status == "failed"
    assert re.search(detail, result.detail), result.detail


def test_a_wrong_one_leaves_nothing_behind(sample):
    threads, state = torch.get_num_threads(), torch.get_rng_state()
    before = sample.image.rgb.clone()
    for name in ("threads-kept", "state-kept", "observe-input-unchanged"):
        check_estimator(WRONG[name], sample=sample, only=[name])
    assert torch.get_num_threads() == threads
    assert torch.equal(torch.get_rng_state(), state)
    assert torch.equal(sample.image.rgb, before)
