import math
from dataclasses import replace

import pytest
import torch

from plugins.known_shading import KnownShading
from plugins.uniform import Uniform
from toolkit import Camera, Chord, ConfigError, LinearImage, NoiseModel, measure
from toolkit.ball import Disc, SharpBall
from toolkit.registry import build
from toolkit.synthetic import (
    LambertBall,
    Scene,
    StraightPath,
    benchmark_scene,
    flat_background,
    render_shot,
    true_disc,
)

DISC = Disc(centre=(40.0, 30.0), semi_axes=(20.0, 20.0), angle=0.0, std=0.05)
SHINY = LambertBall(colour=(0.8, 0.4, 0.1), light=(-0.9, -0.3, -0.4), highlight=0.5)
NOISE = NoiseModel(
    read_variance=torch.full((1, 3), 1e-4), gain=torch.zeros(1, 3), density=torch.ones(3)
)


def light_at(appearance, x, y, view=(0.0, 0.0, 1.0), radius=0.0):
    """What a ball shows at places on its unit disc; beyond the rim, that of the rim.

    It is seen along `view` and appears under the angle 2 `radius`: from afar where that is 0.
    """
    view = torch.nn.functional.normalize(torch.tensor(view, dtype=x.dtype), dim=0)
    axes = torch.eye(3, dtype=x.dtype)
    right, down = (e - (e @ view) / (1 + view[2]) * (view + axes[2]) for e in axes[:2])
    reach = torch.hypot(x, y)
    # the ray is inclined too, and meets the surface nearer to the middle by as much
    angle = torch.asin(reach.clamp_max(1)) - radius * reach.clamp_max(1)
    shorter = angle.sin() / reach.clamp_min(1e-12)
    x, y = ((x * shorter)[..., None], (y * shorter)[..., None])
    normal = x * right + y * down - angle.cos()[..., None] * view
    return appearance(normal.reshape(-1, 3), 0.0).reshape(normal.shape)


def sharp(appearance, size=257, disc=DISC, **seen):
    places = torch.linspace(-1, 1, size, dtype=torch.float64)
    y, x = torch.meshgrid(places, places, indexing="ij")
    light = light_at(appearance, x, y, **seen)
    return SharpBall(disc=disc, rgb=light.movedim(-1, 0).float())


def by_quadrature(appearance, offset, direction, start, stop, count=2000):
    share = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    along = start[..., None] + (stop - start)[..., None] * share
    along = (1 - offset * offset).sqrt()[..., None] * along
    offset, direction = offset[..., None], direction[..., None]
    x = -direction.sin() * offset + direction.cos() * along
    y = direction.cos() * offset + direction.sin() * along
    return light_at(appearance, x, y).mean(-2)


def random_chords(count=300, seed=0):
    generator = torch.Generator().manual_seed(seed)
    draw = 2 * torch.rand(4, count, 1, generator=generator, dtype=torch.float64) - 1
    offset, start, stop = draw[0], draw[2], draw[3]
    return offset, 7 * draw[1], start, stop


@pytest.fixture(scope="module")
def estimator():
    return KnownShading(ball=sharp(SHINY))


def test_whole_chords_are_the_disc_s_radon_averages(estimator):
    offset, direction, _, _ = random_chords()
    found = estimator.foreground(Chord(offset=offset, direction=direction), None)
    one = torch.ones_like(offset)
    truth = by_quadrature(SHINY, offset, direction, -one, one)
    assert found.shape == truth.shape == (300, 1, 3)
    assert float((found - truth).abs().max()) < 0.003
    assert float((found - truth).pow(2).mean().sqrt()) < 0.0005


def test_parts_of_chords_are_averages_too(estimator):
    offset, direction, start, stop = random_chords()
    chord = Chord(offset=offset, direction=direction, start=start, stop=stop)
    found = estimator.foreground(chord, None)
    truth = by_quadrature(SHINY, offset, direction, start, stop)
    assert float((found - truth).abs().max()) < 0.005
    assert float((found - truth).pow(2).mean().sqrt()) < 0.001


@pytest.mark.parametrize("is_start", [True, False])
def test_the_ends_of_a_streak_show_chords_up_to_a_rim(estimator, is_start):
    offset, direction, cut, _ = random_chords()
    rim = torch.ones_like(cut)
    ends = (cut, rim) if is_start else (-rim, cut)
    given = {"start": cut} if is_start else {"stop": cut}
    truth = by_quadrature(SHINY, offset, direction, *ends)
    value, slope = estimator.foreground_and_slope(
        Chord(offset=offset, direction=direction, **given)
    )
    # a short part counts as little as it covers of the background
    error = (value - truth) * ((ends[1] - ends[0]) / 2)[..., None]
    assert float(error.abs().max()) < 0.002
    assert float((value - truth).pow(2).mean().sqrt()) < 0.001
    general = Chord(offset=offset, direction=direction, start=ends[0], stop=ends[1])
    same_value, same_slope = estimator.foreground_and_slope(general)
    assert torch.allclose(value, same_value, atol=1e-5)
    assert torch.allclose(slope, same_slope, atol=1e-4)


def test_one_direction_for_many_pixels_gives_the_same(estimator):
    offset, _, start, stop = (values[:, 0] for values in random_chords())
    direction = torch.tensor([0.7], dtype=torch.float64)
    for ends in ({}, {"start": start, "stop": stop}):
        together = estimator.foreground(Chord(offset=offset, direction=direction, **ends), None)
        each = Chord(
            offset=offset[:, None],
            direction=direction.expand(300, 1),
            **{name: values[:, None] for name, values in ends.items()},
        )
        assert together.shape == (300, 3)
        assert torch.allclose(together, estimator.foreground(each, None)[:, 0], atol=1e-12)


def test_parts_make_up_the_whole(estimator):
    offset, direction, cut, _ = random_chords()
    chord = Chord(offset=offset, direction=direction)
    whole = estimator.foreground(chord, None)
    parts = [
        (stop - start)
        / 2
        * estimator.foreground(
            Chord(offset=offset, direction=direction, start=start, stop=stop), None
        ).movedim(-1, 0)
        for start, stop in ((-1.0, cut), (cut, 1.0))
    ]
    # the cubic between offsets is the same, but for parts shorter than the shortest
    assert torch.allclose((parts[0] + parts[1]).movedim(0, -1), whole, atol=1e-3)


@pytest.mark.parametrize("is_part", [False, True])
def test_the_slope_is_the_derivative(estimator, is_part):
    offset, direction, start, stop = random_chords()
    offset = 0.99 * offset
    ends = {"start": start, "stop": stop} if is_part else {}
    step = 1e-6
    value, slope = estimator.foreground_and_slope(Chord(offset=offset, direction=direction, **ends))
    above, below = (
        estimator.foreground(Chord(offset=offset + h, direction=direction, **ends), None)
        for h in (step, -step)
    )
    assert value.shape == slope.shape == (300, 1, 3)
    error = (slope - (above - below) / (2 * step)).abs().amax((1, 2))
    # light looked up between nodes has corners at them, which some differences straddle
    assert (error < 1e-5).double().mean() > 0.99
    assert error.max() < 1e-2


def test_colours_stay_finite_at_the_rim_and_on_points(estimator):
    offset = torch.tensor([-1.0, -1.0 + 1e-7, 0.0, 1.0 - 1e-7, 1.0])
    for ends in ({}, {"start": 0.3, "stop": 0.3}, {"start": 1.0, "stop": 1.0}):
        chord = Chord(offset=offset, direction=torch.tensor([2.0]), **ends)
        value, slope = estimator.foreground_and_slope(chord)
        assert value.dtype == slope.dtype == torch.float32
        assert torch.isfinite(value).all()
        assert torch.isfinite(slope).all()
        rim = light_at(SHINY, -torch.tensor(2.0).sin()[None], torch.tensor(2.0).cos()[None])
        assert torch.allclose(value[-1], rim[0], atol=0.01)


def test_a_point_shows_its_own_colour(estimator):
    offset, direction, place, _ = random_chords()
    offset = 0.9 * offset
    found = estimator.foreground(
        Chord(offset=offset, direction=direction, start=place, stop=place), None
    )
    truth = by_quadrature(SHINY, offset, direction, place, place, count=1)
    assert float((found - truth).pow(2).mean().sqrt()) < 0.005


def test_the_opposite_motion_sees_the_same_chords_backwards(estimator):
    offset, direction, start, stop = random_chords()
    there = Chord(offset=offset, direction=direction, start=start, stop=stop)
    back = Chord(offset=-offset, direction=direction + math.pi, start=-stop, stop=-start)
    assert torch.allclose(
        estimator.foreground(there, None), estimator.foreground(back, None), atol=1e-6
    )


def test_directions_are_continued_smoothly(estimator):
    """Neither value nor derivative jumps."""
    at, h = 0.5, 1e-4
    direction = torch.tensor([at - 2 * h, at - h, at, at + h, at + 2 * h], dtype=torch.float64)
    chord = Chord(offset=torch.full((5, 1), 0.4, dtype=torch.float64), direction=direction[:, None])
    before, near, here, beyond, after = estimator.foreground(chord, None)[:, 0]
    assert torch.allclose((here - before) / (2 * h), (after - here) / (2 * h), atol=2e-3)
    assert torch.allclose((near + beyond) / 2, here, atol=1e-6)


def test_a_plain_ball_has_one_colour_on_every_chord():
    plain = SharpBall(disc=DISC, rgb=torch.tensor([0.8, 0.4, 0.1])[:, None, None].expand(3, 9, 9))
    offset, direction, start, stop = random_chords()
    for ends in ({}, {"start": start, "stop": stop}):
        chord = Chord(offset=offset, direction=direction, **ends)
        value, slope = KnownShading(ball=plain).foreground_and_slope(chord)
        assert torch.allclose(value, torch.tensor([0.8, 0.4, 0.1]).double(), atol=5e-4)
        assert float(slope.abs().max()) < 1e-3


@pytest.mark.parametrize("heading", [0.3, 2.2, -1.9])
def test_rendered_streaks_are_what_the_chords_foretell(heading):
    """Brute force: C = alpha F + (1 - alpha) B across the middle of a streak, ends left out."""
    scene = streak(heading)
    shot = render_shot(scene, step=0.3)
    image, alpha = shot.clean_image, shot.alpha
    position = scene.camera.project(shot.position[None])[0]
    y, x = torch.meshgrid(*(torch.arange(float(size)) for size in alpha.shape), indexing="ij")
    right, down = x - position[0], y - position[1]
    across = -math.sin(heading) * right + math.cos(heading) * down
    along = math.cos(heading) * right + math.sin(heading) * down
    half_width = scene.camera.fx * scene.ball_radius / math.hypot(0, 4000 * scene.ball_radius)
    seen = (along.abs() < 3) & (across.abs() < half_width - 1.5)
    estimator = KnownShading(ball=sharp(SHINY))
    chord = Chord(offset=(across[seen] / half_width), direction=torch.tensor([heading]))
    ball = estimator.foreground(chord, None).mT
    expected = alpha[seen] * ball + (1 - alpha[seen]) * shot.clean_background[:, seen]
    assert float((expected - image[:, seen]).abs().max()) < 0.005
    # and it matters: one colour would miss by much more
    plain = alpha[seen] * ball.mean(-1, keepdim=True)
    plain = plain + (1 - alpha[seen]) * shot.clean_background[:, seen]
    assert float((plain - image[:, seen]).abs().max()) > 0.02


def streak(heading):
    """A distant shiny ball, 40 px wide, through a long lens: seen as a disc from afar."""
    radius, distance, travel = 0.05, 200.0, 0.3
    camera = Camera.centred(220, 220, 20 * math.hypot(0, distance) / radius)
    heading_x, heading_y = math.cos(heading), math.sin(heading)
    return Scene(
        camera=camera,
        path=StraightPath(
            start=(-heading_x * travel / 2, -heading_y * travel / 2, distance),
            start_velocity=(heading_x * travel / 0.02, heading_y * travel / 0.02, 0.0),
        ),
        ball_radius=radius,
        exposure=0.02,
        appearance=SHINY,
        background=flat_background(220, 220, (0.3, 0.3, 0.3)),
        blur=0.3,
    )


def test_the_camera_is_no_option_and_the_light_is_laid_out_once(estimator):
    camera = Camera.centred(80, 60, 400.0)
    seen = estimator.seen_through(camera)
    assert KnownShading.option_names() == ("ball",)
    assert estimator.camera is None
    assert seen.camera is camera
    assert seen.chords is seen.chords
    assert seen.chords is not estimator.chords
    offset, direction, _, _ = random_chords()
    chord = Chord(offset=offset, direction=direction)
    # from 20 radii the outermost three degrees are hidden
    assert torch.allclose(
        seen.foreground(chord, None), estimator.foreground(chord, None), atol=0.04
    )


@pytest.mark.parametrize("is_part", [False, True])
def test_places_are_seen_alike_alone_and_together(estimator, is_part):
    seen = estimator.seen_through(Camera.centred(80, 60, 400.0))
    offset, direction, start, stop = random_chords(count=20)
    offset = 0.99 * offset
    place = 60 * torch.rand(20, 1, 2, generator=torch.Generator().manual_seed(3)).double()
    ends = {"start": start, "stop": stop} if is_part else {}
    chord = Chord(offset=offset, direction=direction, place=place, **ends)
    value, slope = seen.foreground_and_slope(chord)
    assert not torch.allclose(value, estimator.foreground(chord, None), atol=1e-3)
    for i in range(20):
        own = {name: cut[i] for name, cut in ends.items()}
        one = Chord(offset=offset[i], direction=direction[i], place=place[i], **own)
        assert torch.allclose(value[i], seen.foreground(one, None), atol=1e-6)
    step = 1e-6
    above, below = (seen.foreground(replace(chord, offset=offset + h), None) for h in (step, -step))
    error = (slope - (above - below) / (2 * step)).abs().amax((1, 2))
    assert (error < 1e-5).double().mean() > 0.9


def test_a_shaded_ball_is_measured_where_one_colour_misses_it():
    """At 200 R, where one colour for all of it is told from its shade at once."""
    scene = benchmark_scene(width_px=60, length_widths=4, distance_R=200, seed=1)
    scene = replace(scene, appearance=SHINY)
    shot = render_shot(scene, seed=1, step=0.4)
    mean = SHINY(torch.tensor([[0.0, 0.0, -1.0]]), 0.0)[0].tolist()
    errors, told = {}, {}
    disc = true_disc(scene, shot.position.tolist())
    ray = scene.camera.unproject(torch.tensor(disc.centre, dtype=torch.float64))
    ball = sharp(SHINY, disc=disc, view=tuple(ray.tolist()), radius=1 / 200)
    for one in (KnownShading(ball=ball), Uniform(colour=tuple(mean))):
        found = measure(
            shot.image,
            shot.background,
            camera=scene.camera,
            ball_radius=scene.ball_radius,
            exposure=scene.exposure,
            estimator=one,
        )
        width = float(shot.position[2]) / found.position_m[2] - 1
        errors[found.estimator] = (width, found.fit.chi2_per_dof)
        told[found.estimator] = {caution.code for caution in found.warnings}
        if found.estimator == "known-shading":
            assert abs(found.speed_m_s / float(shot.velocity.norm()) - 1) < 0.03
    # 0.2 % of the width is 0.1 R of depth at 50 R
    assert abs(errors["known-shading"][0]) < 0.002
    assert errors["known-shading"][1] < 1.2
    assert errors["uniform"][1] > errors["known-shading"][1] + 0.02
    assert {"shade-fitted", "streak-misfit"} <= told["uniform"]
    assert not {"shade-fitted", "streak-misfit"} & told["known-shading"]


def test_no_chords_have_no_colours(estimator):
    chord = Chord(offset=torch.zeros(0, 7), direction=torch.zeros(0, 1))
    value, slope = estimator.foreground_and_slope(chord)
    assert value.shape == slope.shape == (0, 7, 3)


def test_observe_hands_colours_on_and_adds_both_noises(estimator):
    ground = torch.rand(1, 3, 6, 7, generator=torch.Generator().manual_seed(0))
    shot = ground.flip(-1)
    clipped = torch.zeros(1, 1, 6, 7, dtype=torch.bool)
    observation = estimator.observe(
        LinearImage(rgb=shot, clipped=clipped),
        LinearImage(rgb=ground, clipped=clipped, frames=4),
        NOISE,
    )
    assert torch.equal(observation.signal, shot)
    assert torch.equal(observation.ground, ground)
    assert torch.allclose(observation.variance, torch.tensor(1.25e-4))


@pytest.mark.parametrize(
    ("rgb", "message"),
    [
        (torch.full((3, 9, 9), math.nan), "no finite numbers"),
        (torch.ones(3, 9, 9, dtype=torch.int64), "no finite numbers"),
        (torch.ones(3, 9, 8), r"shape \(3, 9, 8\), not \[3, N, N\]"),
        (torch.ones(9, 9), r"shape \(9, 9\), not \[3, N, N\]"),
        (torch.ones(3, 1, 1), r"shape \(3, 1, 1\), not \[3, N, N\]"),
    ],
)
def test_an_impossible_ball_is_refused(rgb, message):
    with pytest.raises(ConfigError, match=message):
        KnownShading(ball=SharpBall(disc=DISC, rgb=rgb))


def test_something_else_than_a_ball_is_refused():
    with pytest.raises(ConfigError, match="given as str, not seen sharply"):
        KnownShading(ball="ball.png")


def test_it_is_declared_by_its_name(estimator):
    made = build("known-shading", given={"ball": estimator.ball, "colour": (1, 1, 1)}, options={})
    assert isinstance(made, KnownShading)
    with pytest.raises(ConfigError, match=r"known-shading needs .*--ball-image F"):
        build("known-shading", given={}, options={})
