import math
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from toolkit import CalibrationError, LinearImage, MismatchError, read_image
from toolkit.ball import Disc
from toolkit.disc import find_disc, view_disc
from toolkit.synthetic import LambertBall, LitBall, PanelledBall, StripedBall, render_shot
from toolkit.synthetic.render import record

PLAIN_PX, SHADED_PX, PATTERNED_PX = 0.05, 0.1, 0.25
"""Largest error of centre and mean radius, px, at 1 % noise."""
BLUE = (0.1, 0.2, 0.6)


def mean_radius(disc: Disc) -> float:
    return math.sqrt(disc.semi_axes[0] * disc.semi_axes[1])


def outline_error(found: Disc, true: Disc) -> float:
    """Largest distance between two outlines, px."""
    angle = torch.linspace(0, math.tau, 90, dtype=torch.float64)
    rim = true.from_unit(torch.stack([angle.cos(), angle.sin()], dim=-1))
    return float((torch.linalg.vector_norm(found.to_unit(rim), dim=-1) - 1).abs().max()) * (
        mean_radius(true)
    )


def matt(colour):
    return LambertBall(colour=colour)


def shiny(colour):
    return LambertBall(colour=colour, highlight=0.3)


def striped(colour):
    return StripedBall(colours=(colour, BLUE), pole=(0.5, 0.8, 0.3))


def football(colour):
    return LitBall(pattern=PanelledBall(colours=(colour, BLUE)))


def in_coloured_light(colour):
    """A grey ball, red lamp from the left and blue room."""

    def look(normal, time):
        lamp = (normal @ torch.tensor([-0.8, -0.3, -0.52])).clamp_min(0)[:, None]
        room = torch.tensor([0.08, 0.12, 0.3], dtype=normal.dtype)
        return room + lamp * torch.tensor([0.75, 0.35, 0.1], dtype=normal.dtype)

    return look


def behind_a_mosaic(image: LinearImage) -> LinearImage:
    pattern = ((0, 1), (1, 2))
    height, width = (side // 2 * 2 for side in (image.height, image.width))
    channel = torch.tensor(pattern).repeat(height // 2, width // 2)[None, None]
    rgb = image.rgb[..., :height, :width]
    return LinearImage(
        mosaic=rgb.gather(1, channel), pattern=pattern, clipped=image.clipped[..., :height, :width]
    )


@pytest.mark.parametrize("radius_px", [25, 40, 60])
@pytest.mark.parametrize(
    ("look", "limit"),
    [(None, PLAIN_PX), (matt, SHADED_PX), (shiny, SHADED_PX)],
    ids=["plain", "matt", "shiny"],
)
def test_disc_is_found_to_a_small_part_of_a_pixel(sharp_ball, look, limit, radius_px):
    sharp, empty = sharp_ball(look, radius_px=radius_px)
    disc = find_disc(sharp.image, empty)
    assert math.dist(disc.centre, sharp.disc.centre) < limit
    assert mean_radius(disc) == pytest.approx(mean_radius(sharp.disc), abs=limit)
    assert 0 < disc.std < 0.1


@pytest.mark.parametrize("look", [striped, football, in_coloured_light])
def test_patterns_and_coloured_light_cost_little(sharp_ball, look):
    sharp, empty = sharp_ball(look, radius_px=40)
    disc = find_disc(sharp.image, empty)
    assert math.dist(disc.centre, sharp.disc.centre) < PATTERNED_PX
    assert mean_radius(disc) == pytest.approx(mean_radius(sharp.disc), abs=PATTERNED_PX)


def test_mosaic_serves_as_well(sharp_ball):
    sharp, empty = sharp_ball(matt, radius_px=40)
    disc = find_disc(behind_a_mosaic(sharp.image), behind_a_mosaic(empty))
    assert outline_error(disc, sharp.disc) < 0.3


def test_image_off_the_axis_is_an_ellipse(sharp_ball):
    sharp, empty = sharp_ball(None, radius_px=40, distance_R=6, offset=(2.0, -1.5), size=(400, 360))
    assert sharp.disc.semi_axes[0] > 1.05 * sharp.disc.semi_axes[1]
    disc = find_disc(sharp.image, empty)
    assert outline_error(disc, sharp.disc) < 0.1
    turned = (disc.angle - sharp.disc.angle + math.pi / 2) % math.pi - math.pi / 2
    assert abs(turned) < math.radians(2)
    assert disc.semi_axes == pytest.approx(sharp.disc.semi_axes, abs=0.1)


def test_contact_shadow_hardly_matters(sharp_ball):
    sharp, empty = sharp_ball(matt, radius_px=40)
    x, y = sharp.disc.centre
    rows, columns = torch.meshgrid(
        torch.arange(empty.height), torch.arange(empty.width), indexing="ij"
    )
    depth = torch.exp(-(((columns - x - 25) / 45) ** 2) - ((rows - y - 38) / 12) ** 2)
    light = torch.where(sharp.alpha > 0.5, sharp.image.rgb, sharp.image.rgb * (1 - 0.5 * depth))
    disc = find_disc(record(light[0], 0.02), empty)
    assert outline_error(disc, sharp.disc) < 0.4


def test_other_light_is_followed(sharp_ball):
    sharp, empty = sharp_ball(None)
    brighter = record(1.15 * sharp.image.rgb[0], 0.02)
    assert outline_error(find_disc(brighter, empty), sharp.disc) < 0.1


def refusal(image: LinearImage, empty: LinearImage) -> str:
    with pytest.raises(CalibrationError) as caught:
        find_disc(image, empty)
    assert caught.value.exit_code == 5
    assert "\n" not in str(caught.value)
    return str(caught.value)


def with_block(image: LinearImage, rows: slice, columns: slice) -> LinearImage:
    light = image.rgb[0].clone()
    light[:, rows, columns] = torch.tensor([0.8, 0.6, 0.5])[:, None, None]
    return record(light, 0.02)


def test_empty_picture_is_refused(sharp_ball):
    _, empty = sharp_ball(None)
    assert refusal(empty, empty).startswith("no ball found")


@pytest.mark.parametrize("travel_px", [6, 30, 120])
def test_moving_ball_is_refused(moving_ball: Callable[..., object], travel_px):
    shot = moving_ball(travel_px)
    assert refusal(shot.image, shot.background).startswith("the ball moved")


@pytest.fixture
def moving_ball():
    from toolkit.synthetic import benchmark_scene

    def render(travel_px):
        scene = benchmark_scene(width_px=60, length_widths=travel_px / 60, size=(260, 260))
        return render_shot(scene)

    return render


@pytest.mark.parametrize("seen_px", [20, 58])
def test_ball_cut_by_the_border_is_refused(sharp_ball, seen_px):
    sharp, empty = sharp_ball(None)
    left = round(sharp.disc.centre[0] + 30 - seen_px)
    cut = [p.window(left, 0, p.width - left, p.height) for p in (sharp.image, empty)]
    assert "cut by the picture's border" in refusal(*cut)


def test_small_ball_is_refused(sharp_ball):
    sharp, empty = sharp_ball(None, radius_px=9)
    assert "too small" in refusal(sharp.image, empty)


def test_clipped_ball_is_refused(sharp_ball):
    sharp, empty = sharp_ball(matt)
    light = torch.where(sharp.alpha > 0.3, 2 * sharp.image.rgb[0], sharp.image.rgb[0])
    assert "met white" in refusal(record(light.clamp_max(1), 0.02), empty)


def test_hand_is_refused(sharp_ball):
    sharp, empty = sharp_ball(None)
    y, x = round(sharp.disc.centre[1]), round(sharp.disc.centre[0])
    hand = with_block(sharp.image, slice(y - 20, y + 20), slice(x + 15, None))
    assert "more than a ball" in refusal(hand, empty)


@pytest.mark.parametrize("kind", ["square", "triangle"])
def test_what_is_not_round_is_refused(sharp_ball, kind):
    _, empty = sharp_ball(None)
    light = empty.rgb[0].clone()
    rows, columns = torch.meshgrid(
        torch.arange(empty.height), torch.arange(empty.width), indexing="ij"
    )
    half = 30 if kind == "square" else (rows - 60) / 2
    light[:, ((rows - 90).abs() < 30) & ((columns - 90).abs() < half)] = 0.95
    assert "no disc found" in refusal(record(light, 0.02), empty)


def test_pictures_must_belong_together(sharp_ball):
    sharp, empty = sharp_ball(None)
    with pytest.raises(MismatchError, match="same camera and settings"):
        find_disc(sharp.image, empty.window(0, 0, 100, 100))
    with pytest.raises(MismatchError, match="times as bright"):
        find_disc(record(empty.rgb[0] / 20, 0.02), empty)


def test_view_of_a_known_disc(sharp_ball):
    sharp, empty = sharp_ball(None)
    view = view_disc(sharp.image, empty, sharp.disc)
    assert view.picture_disc.centre == pytest.approx(sharp.disc.centre)
    outside = Disc(centre=(5.0, 90.0), semi_axes=(30.0, 30.0), angle=0.0, std=0.0)
    with pytest.raises(MismatchError, match=r"disc about \(5, 90\) px is not inside"):
        view_disc(sharp.image, empty, outside)


@pytest.mark.shared_data
def test_real_streak_is_no_resting_ball():
    folder = Path(__file__).resolve().parents[2].parent / "shared/data/streaks"
    if not folder.is_dir():
        pytest.skip("the real pictures are not beside the project")
    shot, empty = (read_image(folder / f"{n}.png") for n in ("floorball1", "floorball_bgr"))
    assert refusal(shot, empty).startswith("the ball moved")
