"""Finding the streak and tracing its axis."""

import cv2
import numpy as np
import pytest
import torch

from plugins.uniform import Uniform
from toolkit import ConfigError, LinearImage, StreakError
from toolkit.background import estimate_noise
from toolkit.demosaicing import demosaic
from toolkit.middle_line import trace_axis
from toolkit.streak import find_streak, refine_axis
from toolkit.streak_shape import regions
from toolkit.synthetic import NoiseLevel, add_noise, benchmark_scene, render_shot
from toolkit.synthetic.render import BACKGROUND, SHOT, record
from toolkit.view import observe_streak


@pytest.fixture(scope="module")
def shot():
    return render_shot(
        benchmark_scene(width_px=24, length_widths=5, heading=0.5, size=(260, 220), seed=2), seed=2
    )


def search(shot, image=None, roi=None):
    image = shot.image if image is None else image
    noise = estimate_noise(image, shot.background)
    estimator = Uniform(colour=shot.scene.appearance.colour)
    return find_streak(image, shot.background, noise, estimator, roi)


def painted(image, rows, columns, colour):
    rgb = image.rgb.clone()
    rgb[0, :, rows, columns] = torch.tensor(colour)[:, None, None]
    return LinearImage(rgb=rgb, clipped=image.clipped)


def behind_mosaic(image):
    pattern = ((0, 1), (1, 2))
    channel = torch.tensor(pattern).repeat(image.height // 2 + 1, image.width // 2 + 1)
    mosaic = image.rgb.gather(1, channel[None, None, : image.height, : image.width])
    return LinearImage(mosaic=mosaic, clipped=image.clipped, pattern=pattern)


def true_centres(shot):
    time = torch.linspace(0, shot.scene.exposure, 50, dtype=torch.float64)
    return shot.scene.camera.project(shot.scene.path.position(time))


def test_the_axis_follows_the_ball_from_left_to_right(shot):
    streak = search(shot)
    gaps = torch.cdist(true_centres(shot), streak.axis[0]).min(1).values
    assert gaps.max() < 1.5
    assert streak.axis[0, -1, 0] > streak.axis[0, 0, 0]
    assert float(streak.half_width) == pytest.approx(12, abs=3)
    assert int(streak.mask.sum()) == pytest.approx(int((shot.alpha > 0.03).sum()), rel=0.15)


def test_a_dark_bystander_is_not_the_ball(shot):
    image = painted(shot.image, slice(0, 40), slice(0, 200), (0.0, 0.0, 0.0))
    found, alone = search(shot, image), search(shot)
    assert torch.allclose(found.axis, alone.axis, atol=1.0)


def test_a_region_is_searched_alone(shot):
    with pytest.raises(StreakError, match="no ball found"):
        search(shot, roi=(0, 0, 40, 40))


@pytest.mark.parametrize("roi", [(-1, 0, 50, 50), (0, 0, 999, 50), (10, 10, 0, 5)])
def test_a_region_outside_the_picture_is_refused(shot, roi):
    with pytest.raises(ConfigError, match="does not lie inside"):
        search(shot, roi=roi)


def test_a_picture_without_the_ball_is_refused(shot):
    with pytest.raises(StreakError, match="no ball found"):
        search(shot, shot.background)


def rendered(width, length, size, noise=0.01, **scene):
    level = NoiseLevel(read=noise)
    scene = benchmark_scene(width_px=width, length_widths=length, size=size, noise=level, **scene)
    return render_shot(scene, seed=3, step=0.5)


@pytest.mark.parametrize("colour_is_known", [True, False])
@pytest.mark.parametrize(
    ("width", "length", "size", "noise"),
    [
        (24, 0.0, (120, 100), 0.005),
        (20, 0.0, (1300, 900), 0.03),
        (20, 1.0, (1300, 900), 0.03),
        (40, 0.5, (200, 160), 0.03),
        (90, 0.3, (260, 260), 0.01),
        (90, 1.5, (400, 400), 0.01),
    ],
)
def test_a_ball_that_hardly_moved_is_found(width, length, size, noise, colour_is_known):
    shot = rendered(width, length, size, noise)
    colour = shot.scene.appearance.colour if colour_is_known else None
    level = estimate_noise(shot.image, shot.background)
    streak = find_streak(shot.image, shot.background, level, Uniform(colour=colour))
    middle = streak.axis[0].mean(0)
    assert (middle - true_centres(shot).mean(0)).norm() < 0.15 * width
    assert float(streak.half_width) == pytest.approx(width / 2, rel=0.3)
    assert 0.4 * length < streak.widths + 0.01 < length + 0.3
    covered = streak.mask[0, 0] & (shot.alpha > 0)
    assert int(covered.sum()) > 0.9 * int((shot.alpha > 0.1).sum())


def test_travel_tells_short_from_long(shot):
    assert search(shot).widths == pytest.approx(4.5, abs=0.7)


def test_a_spot_that_only_darkens_is_no_black_ball():
    size = (200, 160)
    ground = rendered(30, 0.0, size).background
    y, x = torch.meshgrid(torch.arange(size[1]), torch.arange(size[0]), indexing="ij")
    shadow = 1 - 0.3 * ((x - 100).square() + (y - 80).square() < 400)
    image = LinearImage(rgb=ground.rgb * shadow, clipped=ground.clipped)
    noise = estimate_noise(image, ground)
    with pytest.raises(StreakError, match="no streak found"):
        find_streak(image, ground, noise, Uniform(colour=(0.0, 0.0, 0.0)))


def test_a_ragged_spot_is_no_ball():
    ground = rendered(30, 0.0, (200, 160)).background
    angle, reach = np.arange(10) * np.pi / 5, np.where(np.arange(10) % 2, 14, 70)  # a star
    corners = np.stack([100 + reach * np.cos(angle), 80 + reach * np.sin(angle)], -1)
    spot = cv2.fillPoly(np.zeros((160, 200), np.float32), [corners.astype(np.int32)], 1.0)
    alpha, colour = torch.from_numpy(spot), torch.tensor([1.0, 0.6, 0.1])[:, None, None]
    image = LinearImage(rgb=torch.lerp(ground.rgb, colour, alpha), clipped=ground.clipped)
    with pytest.raises(StreakError, match="no streak found"):
        find_streak(image, ground, estimate_noise(image, ground), Uniform())


@pytest.mark.parametrize("colour", [(0.8, 0.5, 0.1), None])
@pytest.mark.parametrize("size", [(120, 100), (1300, 900)])
def test_noise_alone_is_no_ball(size, colour):
    scene = benchmark_scene(width_px=20, length_widths=0, size=size)
    empty = render_shot(scene, step=3.0, supersampling=1).clean_background
    for seed in range(4):
        image, ground = (
            record(add_noise(empty, NoiseLevel(read=0.02), seed, stream), 0.02)
            for stream in (SHOT, BACKGROUND)
        )
        with pytest.raises(StreakError, match=r"no (ball|streak) found"):
            find_streak(image, ground, estimate_noise(image, ground), Uniform(colour=colour))


@pytest.mark.parametrize("size", [(260, 220), (1021, 500)])
def test_the_streak_is_found_behind_a_mosaic(size):
    shot = render_shot(
        benchmark_scene(width_px=24, length_widths=5, heading=0.5, size=size, seed=2), seed=2
    )
    image, background = (behind_mosaic(p) for p in (shot.image, shot.background))
    estimator = Uniform(colour=shot.scene.appearance.colour)
    streak = find_streak(image, background, estimate_noise(image, background), estimator)
    gaps = torch.cdist(true_centres(shot), streak.axis[0]).min(1).values
    assert gaps.max() < 2
    assert float(streak.half_width) == pytest.approx(12, abs=3)
    assert streak.mask.shape == image.clipped.shape


def test_only_the_window_of_a_large_mosaic_is_demosaiced(monkeypatch):
    shot = render_shot(
        benchmark_scene(width_px=24, length_widths=5, heading=0.5, size=(1021, 500), seed=2), seed=2
    )
    sizes = []

    def noted(mosaic, pattern):
        sizes.append(mosaic.size)
        return demosaic(mosaic, pattern)

    monkeypatch.setattr("toolkit.types.demosaic", noted)
    estimator = Uniform(colour=shot.scene.appearance.colour)
    view = observe_streak(behind_mosaic(shot.image), behind_mosaic(shot.background), estimator)
    assert len(sizes) == 2
    assert max(sizes) < 1.1 * view.clipped.numel() < 0.2 * 1021 * 500


@pytest.mark.parametrize("turn", [0.0, 1.2, 2.4])
def test_the_traced_axis_follows_an_arc(turn):
    angle = np.linspace(0, np.pi * 0.6, 60) + turn
    points = np.stack([150 + 90 * np.cos(angle), 150 + 90 * np.sin(angle)], -1)
    mask = np.zeros((300, 300), np.uint8)
    cv2.polylines(mask, [points.round().astype(np.int32)[:, None]], False, 1, thickness=21)
    axis, half_width = trace_axis(mask)
    radius = np.hypot(axis[:, 0] - 150, axis[:, 1] - 150)
    assert np.abs(radius[8:-8] - 90).max() < 2.5
    assert half_width == pytest.approx(10.5, abs=2)


def test_the_traced_axis_keeps_to_the_middle_of_two_throws():
    time = np.linspace(0, 1.9, 200)
    x, height = 40 + 160 * time, 220 * np.abs(np.sin(np.pi * time)) ** 0.8
    points = np.stack([x, 260 - height], -1)
    mask = np.zeros((300, 400), np.uint8)
    cv2.polylines(mask, [points.round().astype(np.int32)[:, None]], False, 1, thickness=19)
    axis, half_width = trace_axis(mask)
    apart = np.linalg.norm(axis[:, None] - points, axis=-1).min(1)
    assert np.sort(apart)[-12] < 0.5 * half_width  # all but at tips and corner
    assert np.abs(axis[0] - points[0]).max() < 2 * half_width
    assert np.abs(axis[-1] - points[-1]).max() < 2 * half_width
    assert half_width == pytest.approx(9.5, abs=3.5)


def band(length, thickness, start=60):
    mask = np.zeros((120, 320), np.uint8)
    cv2.line(mask, (start, 60), (start + length, 60), 1, thickness=thickness)
    return mask


def test_a_streak_goes_on_where_it_is_faint():
    core = band(60, 17, start=120)
    (alone,) = regions(core, core, 60)
    (whole,) = regions(core, band(220, 21), 60)
    assert alone.mask.sum() < 0.4 * whole.mask.sum()
    assert whole.axis[[0, -1], 0] == pytest.approx([50, 290], abs=4)


def test_what_is_faint_about_a_streak_is_none_of_it():
    core = band(100, 21)
    shadow = core.copy()
    cv2.circle(shadow, (110, 60), 45, 1, -1)
    rim = band(100, 25)
    (alone,) = regions(core, core, 60)
    for faint in (shadow, rim):
        (found,) = regions(core, faint, 60)
        assert np.array_equal(found.mask, alone.mask)


def test_two_clear_parts_of_one_streak_are_one():
    core = band(40, 17) | band(40, 17, start=200)
    assert len(list(regions(core, core, 60))) == 2
    assert len(list(regions(core, band(180, 21), 60))) == 1


@pytest.mark.parametrize("turn", [0.0, 0.4, 1.3, 2.5])
def test_the_axis_of_a_straight_streak_runs_from_tip_to_tip(turn):
    direction = np.array([np.cos(turn), np.sin(turn)])
    ends = 150 + 90 * np.array([[-1], [1]]) * direction
    mask = np.zeros((300, 300), np.uint8)
    cv2.line(mask, *ends.round().astype(int).tolist(), 1, thickness=41)
    axis, half_width = trace_axis(mask)
    along, across = (axis - 150) @ direction, (axis - 150) @ (-direction[1], direction[0])
    assert np.abs(across).max() < 0.7
    assert np.abs(along[[0, -1]]) == pytest.approx(90 + 20.5, abs=1.5)
    assert half_width == pytest.approx(20.5, abs=2)


def test_the_refined_axis_ignores_profiles_without_weight():
    position = torch.arange(80, dtype=torch.float64)
    middle = torch.stack([position, 0.2 * position], dim=-1)
    middle[60:] += 30
    weight = torch.ones(80, dtype=torch.float64)
    weight[60:] = 0
    axis = refine_axis(middle, weight, position, (2, 3))
    assert torch.allclose(axis[0, :, 1], 0.2 * axis[0, :, 0], atol=1e-6)
    assert axis[0, -1, 0] > 75  # continued straight to where the old axis ended
