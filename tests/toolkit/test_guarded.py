from dataclasses import dataclass, replace

import pytest
import torch

from toolkit import (
    AlphaEstimator,
    BadOutputError,
    Chord,
    ImageError,
    LinearImage,
    NoiseModel,
    Observation,
    StreakError,
    measure,
)
from toolkit.guarded import guarded
from toolkit.synthetic import benchmark_scene, render_shot

NOISE = NoiseModel(
    read_variance=torch.full((1, 3), 1e-4), gain=torch.zeros(1, 3), density=torch.ones(3)
)
OFFSET = torch.linspace(-1, 1, 7).expand(4, 7)
CHORD = Chord(offset=OFFSET, direction=torch.zeros(4, 1))


@dataclass(frozen=True, kw_only=True)
class Plain(AlphaEstimator):
    colour: tuple[float, float, float] = (0.9, 0.6, 0.1)

    def observe(self, image, background, noise):
        variance = noise.variance(image.rgb) + noise.variance(background.rgb)
        return Observation(signal=image.rgb, ground=background.rgb, variance=variance)

    def foreground(self, chord, appearance):
        return chord.offset.new_tensor(self.colour).expand(*chord.offset.shape, 3)


def spoilt(**methods) -> AlphaEstimator:
    """A plain estimator, some of its methods replaced."""
    return dataclass(frozen=True, kw_only=True)(type("Spoilt", (Plain,), methods))()


def picture(value=0.2) -> LinearImage:
    rgb = torch.full((1, 3, 8, 9), value)
    return LinearImage(rgb=rgb, clipped=torch.zeros(1, 1, 8, 9, dtype=torch.bool))


def observing(change) -> AlphaEstimator:
    return spoilt(observe=lambda self, i, b, n: change(Plain.observe(self, i, b, n)))


def seeing(change) -> AlphaEstimator:
    return spoilt(foreground=lambda self, c, a: change(Plain.foreground(self, c, a)))


def raising(error):
    def method(self, *words):
        raise error

    return method


def test_every_question_is_guarded():
    """A new question of the interface must be handed on, or the guard would answer for it."""
    final = {name for name, value in vars(AlphaEstimator).items() if is_final(value)}
    questions = {
        name
        for name, value in vars(AlphaEstimator).items()
        if not name.startswith("_") and (callable(value) or isinstance(value, property))
    }
    assert questions - final <= set(vars(type(guarded(Plain()))))


def is_final(value) -> bool:
    return getattr(getattr(value, "__func__", value), "__final__", False)


def test_good_answers_pass_unchanged():
    door = guarded(Plain())
    assert guarded(door) is door
    seen = door.observe(picture(0.3), picture(), NOISE)
    assert torch.equal(seen.signal, picture(0.3).rgb)
    assert torch.equal(door.foreground(CHORD, None), Plain().foreground(CHORD, None))
    value, slope = door.foreground_and_slope(CHORD)
    assert torch.equal(value, door.foreground(CHORD, None))
    assert slope is None
    assert door.unknowns() == 0


def test_an_infinite_variance_says_that_nothing_was_measured():
    door = guarded(observing(lambda seen: replace(seen, variance=seen.variance / 0)))
    assert torch.isinf(door.observe(picture(), picture(), NOISE).variance).all()


def test_doubts_reach_the_result_s_cautions_or_are_refused():
    class Doubting(Plain):
        def doubts(self):
            return {"old-colour": "its colour is a year old"}

    class Mumbling(Plain):
        def doubts(self):
            return ["well"]

    assert guarded(Doubting()).doubts() == {"old-colour": "its colour is a year old"}
    with pytest.raises(BadOutputError, match="something else than messages by code"):
        guarded(Mumbling()).doubts()


@pytest.mark.parametrize(
    ("change", "trouble"),
    [
        (lambda seen: None, "gives a NoneType, not an Observation"),
        (lambda seen: replace(seen, signal=seen.signal.numpy()), "gives ndarray, Tensor, Tensor"),
        (lambda seen: replace(seen, signal=seen.signal[0]), r"shapes \[3, 8, 9\]"),
        (lambda seen: replace(seen, variance=seen.variance[:, :1]), r"\[1, 1, 8, 9\]; \[1, Q, 8,"),
        (lambda seen: replace(seen, ground=seen.ground[..., 1:]), r"\[1, 3, 8, 8\]"),
        (lambda seen: replace(seen, signal=seen.signal.double()), "gives torch.float64, torch.fl"),
        (lambda seen: replace(seen, signal=seen.signal * torch.nan), "that are not finite"),
        (lambda seen: replace(seen, ground=seen.ground / 0), "that are not finite"),
        (lambda seen: replace(seen, variance=-seen.variance), "variances that are negative"),
        (lambda seen: replace(seen, variance=seen.variance * torch.nan), "or no number"),
        (
            lambda seen: Observation(
                **{key: getattr(seen, key)[:, :2] for key in ("signal", "ground", "variance")}
            ),
            "gives 3 channels where its observe gives 2",
        ),
    ],
)
def test_a_bad_observation_is_refused(change, trouble):
    with pytest.raises(BadOutputError, match=trouble) as caught:
        guarded(observing(change)).observe(picture(), picture(), NOISE)
    assert str(caught.value).startswith("estimator 'spoilt': its ")
    assert "author" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "trouble"),
    [
        (lambda value: value.tolist(), "gives a list, not a tensor"),
        (lambda value: value[0], r"gives shape \[7, 3\]; \[4, 7, Q\] is needed"),
        (lambda value: value[..., 0], r"gives shape \[4, 7\]"),
        (lambda value: value.double(), "gives torch.float64 for offsets in torch.float32"),
        (lambda value: value * torch.nan, "not finite"),
    ],
)
def test_a_bad_foreground_is_refused(change, trouble):
    door = guarded(seeing(change))
    with pytest.raises(BadOutputError, match=trouble):
        door.foreground(CHORD, None)
    with pytest.raises(BadOutputError, match="foreground_and_slope"):
        door.foreground_and_slope(CHORD)


@pytest.mark.parametrize(
    ("answer", "trouble"),
    [
        (lambda value: value, "gives a Tensor, not a value and its slope"),
        (lambda value: (value, value[..., :1]), "value and slope of different shapes"),
        (lambda value: (value, value * torch.nan), "not finite"),
    ],
)
def test_a_bad_slope_is_refused(answer, trouble):
    method = lambda self, chord, appearance: answer(Plain.foreground(self, chord, None))  # noqa: E731
    with pytest.raises(BadOutputError, match=trouble):
        guarded(spoilt(foreground_and_slope=method)).foreground_and_slope(CHORD)


@pytest.mark.parametrize("count", [-1, True, "three"])
def test_a_bad_number_of_unknowns_is_refused(count):
    with pytest.raises(BadOutputError, match="not a number from 0 up"):
        guarded(spoilt(unknowns=lambda self: count)).unknowns()


@pytest.mark.parametrize("error", [ValueError("two\nlines"), KeyError("k"), SystemExit(3)])
def test_what_it_raises_names_it(error):
    door = guarded(spoilt(observe=raising(error)))
    with pytest.raises(BadOutputError, match=rf"its observe breaks with {type(error).__name__}"):
        door.observe(picture(), picture(), NOISE)


@pytest.mark.parametrize("error", [StreakError("why"), KeyboardInterrupt(), MemoryError()])
def test_a_reasoned_refusal_and_an_interrupt_pass(error):
    with pytest.raises(type(error)):
        guarded(spoilt(foreground=raising(error))).foreground(CHORD, None)


def test_a_picture_that_is_not_finite_is_not_the_estimator_s_fault():
    with pytest.raises(ImageError, match="the shot holds values that are not finite"):
        guarded(Plain()).observe(picture(torch.nan), picture(), NOISE)
    with pytest.raises(ImageError, match="the background holds"):
        guarded(Plain()).observe(picture(), picture(torch.inf), NOISE)


@pytest.mark.parametrize(
    ("estimator", "trouble"),
    [
        (observing(lambda seen: replace(seen, signal=seen.signal * torch.nan)), "its observe"),
        (seeing(lambda value: value[..., :2]), "its foreground"),
        (seeing(lambda value: value / 0), "its foreground"),
        (spoilt(foreground_and_slope=raising(ZeroDivisionError())), "its foreground_and_slope"),
    ],
)
def test_measuring_names_the_estimator(shot, estimator, trouble):
    with pytest.raises(BadOutputError, match=f"^estimator 'spoilt': {trouble}"):
        measure(
            shot.image,
            shot.background,
            camera=shot.scene.camera,
            ball_radius=shot.scene.ball_radius,
            exposure=shot.scene.exposure,
            estimator=estimator,
        )


@pytest.fixture(scope="module")
def shot():
    return render_shot(benchmark_scene(width_px=30, length_widths=4), seed=1)
