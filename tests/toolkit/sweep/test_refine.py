import functools
import math
from dataclasses import replace

import pytest
import torch

from plugins.uniform import Uniform
from toolkit import StreakError
from toolkit.sweep import fit as sweep_fit
from toolkit.sweep import refine as sweep_refine
from toolkit.sweep.explain import other_colour
from toolkit.sweep.refine import Shutter, refine
from toolkit.sweep.shade import Shaded
from toolkit.synthetic import StraightPath
from toolkit.view import observe_streak


def refined(seen, image=None, start=None, estimator=None, **options):
    scene = seen.scene
    estimator = estimator or seen.estimator
    view = observe_streak(image or seen.shot.image, seen.shot.background, estimator)
    shutter = Shutter(exposure=scene.exposure, readout=scene.readout, rows=scene.camera.height)
    return refine(
        view,
        estimator,
        scene.camera,
        scene.ball_radius,
        start or seen.start(is_close=True),
        shutter,
        **options,
    )


def test_a_shutter_tells_its_rows_apart():
    shutter = Shutter(exposure=0.02, readout=0.01, rows=101)
    assert shutter.row_delay == pytest.approx(0.005)
    assert shutter.delay_of(50) == pytest.approx(0.005)
    assert Shutter(exposure=None, readout=0.01, rows=101).row_delay == 0
    assert Shutter(exposure=0.02, readout=0.01, rows=1).row_delay == 0


@pytest.fixture(scope="module")
def plain(streak):
    return streak(length_widths=2.0)


def test_without_a_readout_the_sign_stays_open(plain):
    found = refined(plain)
    assert found.sign is None
    assert found.delay == 0
    assert found.still_below is None
    assert not found.misfit.significant


def rolling(heading, scene):
    """A ball that crosses the picture's middle as that row is exposed."""
    middle = scene.path.position(torch.tensor([scene.exposure / 2]))[0]
    speed = 4 * scene.ball_radius / scene.exposure
    velocity = speed * torch.tensor([math.cos(heading), math.sin(heading), 0.0])
    readout = 0.3 * scene.exposure
    start = middle - velocity * (scene.exposure + readout) / 2
    path = StraightPath(start=tuple(start.tolist()), start_velocity=tuple(velocity.tolist()))
    return replace(scene, path=path, readout=readout)


WAYS = {"with the readout": 1.4, "against it": -1.4, "across it": 0.1}
CHANGES = {name: functools.partial(rolling, heading) for name, heading in WAYS.items()}


@pytest.mark.parametrize(
    ("name", "is_reversed"),
    [*((name, False) for name in WAYS), ("with the readout", True)],
)
def test_a_readout_decides_the_sign_whichever_way_the_search_begins(streak, name, is_reversed):
    seen = streak(change=CHANGES[name], length_widths=2.0, width_px=24)
    points = seen.points()
    start = seen.start(path=points.flip(0) if is_reversed else points, is_close=True)
    found = refined(seen, start=start)
    assert not found.sign.ambiguous
    assert (found.sign.cue, found.sign.probability > 0.99) == ("readout", True)
    _, displacement = found.fit.state()
    first, last = seen.points(2)
    assert torch.nn.functional.cosine_similarity(displacement, last - first, dim=0) > 0.99
    (other,) = found.sign.alternatives
    assert other.probability == pytest.approx(1 - found.sign.probability)
    assert torch.tensor(other.direction).double() @ (last - first) < 0
    # the state is that of the row on which the ball then was
    at = seen.scene.own_time(0.5)
    assert found.delay + seen.scene.exposure / 2 == pytest.approx(
        at, abs=0.02 * seen.scene.exposure
    )
    position, _ = found.fit.state()
    truth = seen.shot.position_at(found.delay + seen.scene.exposure / 2)
    std = found.uncertainty.total.diagonal()[:3].sqrt()
    assert ((position - truth).abs() < 4 * std).all()


def test_where_the_readout_tells_little_the_odds_stay_near_even(streak):
    """The same shot, its readout so short that both ways explain it alike."""
    seen = streak(length_widths=2.0, heading=0.0)
    scene = replace(seen.scene, readout=1e-6 * seen.scene.exposure)
    found = refined(replace(seen, shot=replace(seen.shot, scene=scene)))
    assert found.sign.ambiguous
    assert found.sign.cue is None
    assert found.sign.probability == pytest.approx(0.5, abs=0.05)


def test_a_response_that_nobody_named_is_doubted(plain):
    """By five per cent of its exponent where it was assumed, by two where somebody named it."""
    stds = []
    for response, is_assumed in (("linear", False), ("srgb", False), ("srgb", True)):
        image = replace(plain.shot.image, response=response, response_is_assumed=is_assumed)
        brightness = refined(plain, image=image).uncertainty.brightness
        stds.append(brightness.diagonal()[6].sqrt())
    assert stds[0] == 0
    assert float(stds[2] / stds[1]) == pytest.approx(2.5, rel=0.1)


def test_a_search_that_does_not_settle_is_refused(plain, monkeypatch):
    monkeypatch.setattr(sweep_fit, "MAX_STEPS", 0)
    with pytest.raises(StreakError, match="does not settle on one motion"):
        refined(plain, start=plain.start(path=1.05 * plain.points()))


def test_a_streak_that_no_motion_explains_is_refused(plain, monkeypatch):
    monkeypatch.setattr(sweep_refine, "UNEXPLAINED", 0.9)
    with pytest.raises(
        StreakError, match=r"no motion of such a ball explains the streak: 1\.0 times"
    ):
        refined(plain)


def test_a_path_that_leaves_its_profiles_is_refused(plain):
    """Profiles half a width aside, which the search leaves for the streak."""
    aside = plain.points() + torch.tensor([0.0, 0.9 * plain.scene.ball_radius, 0.0])
    with pytest.raises(StreakError, match=r"runs away from its profiles, by 0\.[789]"):
        refined(plain, start=plain.start(path=aside, is_close=True))
    found = refined(plain, start=plain.start(path=aside))
    assert found.fit.converged


def test_a_streak_much_wider_than_its_profiles_is_refused(plain):
    """Profiles of a ball half as far again, on the same path in the picture."""
    far = 1.5 * plain.points()
    with pytest.raises(StreakError, match=r"runs away from its profiles, by 0\.[56]"):
        refined(plain, start=plain.start(path=far, is_close=True))
    near = 1.1 * plain.points()
    assert refined(plain, start=plain.start(path=near, is_close=True)).fit.converged


def true_state(seen, displacement):
    """Position and travel [6], the way that was found."""
    first, middle, last = seen.points(3)
    travel = last - first
    return torch.cat([middle, travel * torch.sign(travel @ displacement)])


@pytest.mark.parametrize("share", [0.8, 1.2])
def test_a_ball_of_another_colour_than_known_is_measured_by_its_own(streak, share):
    """Too dark or too bright: a shade and a wrong distance would explain most of it."""
    seen = streak(width_px=60, length_widths=2.0)
    true = torch.tensor(seen.scene.appearance.colour)
    found = refined(seen, estimator=Uniform(colour=tuple((share * true).tolist())))
    assert found.fit.model.estimator.is_recoloured
    position, displacement = found.fit.state()
    error = torch.cat([position, displacement]) - true_state(seen, displacement)
    assert (error.abs() < 3.5 * found.uncertainty.total.diagonal()[:6].sqrt()).all()
    told = other_colour(found.fit, found.misfit.factor)
    assert told == pytest.approx(1 / share - 1, abs=0.02)


def test_a_ball_of_quite_another_colour_than_known_is_refused(streak):
    seen = streak(width_px=60, length_widths=2.0)
    colour = tuple(0.5 * channel for channel in seen.scene.appearance.colour)
    with pytest.raises(StreakError, match=r"runs away from its profiles|explains the streak"):
        refined(seen, estimator=Uniform(colour=colour))


def test_a_ball_that_is_held_to_another_colour_is_refused(streak, monkeypatch):
    monkeypatch.setattr(Shaded, "powers_above", staticmethod(lambda _: (1, 2)))
    monkeypatch.setattr(sweep_refine, "fit_with_marks", lambda *_: None)
    seen = streak(width_px=60, length_widths=2.0)
    colour = tuple(0.8 * channel for channel in seen.scene.appearance.colour)
    with pytest.raises(StreakError, match="does not show the one colour it is known by"):
        refined(seen, estimator=Uniform(colour=colour))
