import math

import pytest
import torch

from toolkit.alpha import Observation
from toolkit.errors import ShapeError
from toolkit.profiles import axis_bend, gather_profiles, place_profiles

WIDTH, HEIGHT = 90, 70


def ramp(width=WIDTH, height=HEIGHT, left=0, top=0, slope=(0.5, -0.25)):
    """A picture whose value at (x, y) of the whole picture is 3 + slope . (x, y)."""
    y, x = torch.meshgrid(
        torch.arange(height).double() + top, torch.arange(width).double() + left, indexing="ij"
    )
    return (3 + slope[0] * x + slope[1] * y)[None, None]


def observation(picture):
    return Observation(signal=picture, ground=0.5 * picture, variance=0.01 * picture.abs() + 1e-4)


def unclipped(picture):
    return torch.zeros_like(picture[:, :1], dtype=torch.bool)


def line(start, stop, count=16):
    share = torch.linspace(0, 1, count, dtype=torch.float64)[:, None]
    return (torch.tensor(start) * (1 - share) + torch.tensor(stop) * share)[None]


def arc(radius, centre=(45.0, 60.0), angles=(-2.4, -0.8), count=64):
    """A circle's arc over the top of its centre, which then lies on the right of the motion."""
    angle = torch.linspace(*angles, count, dtype=torch.float64)
    points = torch.stack([angle.cos(), angle.sin()], dim=-1) * radius
    return (points + torch.tensor(centre, dtype=torch.float64))[None]


def places(profiles):
    """Where the pixels of the profiles lie: origin + offset * normal, [B, P, S, 2]."""
    return profiles.origin[:, :, None] + profiles.offset[..., None] * profiles.normal[:, :, None]


def gathered(axis, reach=15.0, **options):
    picture = ramp()
    return gather_profiles(observation(picture), unclipped(picture), axis, reach, **options)


@pytest.mark.parametrize(
    ("start", "stop"), [((20.0, 30.0), (70.0, 30.0)), ((20.3, 22.6), (64.1, 49.2))]
)
def test_profiles_are_one_px_apart_and_square_to_the_axis(start, stop):
    origin, normal, position = place_profiles(line(start, stop))
    length = math.dist(start, stop)
    count = round(length) + 1
    assert origin.shape == normal.shape == (1, count, 2)
    assert torch.allclose(position[0], torch.linspace(0, length, count).double(), atol=1e-5)
    assert origin[0, 0].tolist() == pytest.approx(start)
    assert origin[0, -1].tolist() == pytest.approx(stop)
    assert torch.allclose(normal.norm(dim=-1), torch.ones(1, count).double())
    along = (torch.tensor(stop) - torch.tensor(start)).double()
    assert (normal[0] @ along).abs().max() < 1e-9


@pytest.mark.parametrize(
    ("stop", "right"),
    [((60.0, 30.0), (0, 1)), ((30.0, 60.0), (-1, 0)), ((0.0, 30.0), (0, -1))],
    ids=["to the right", "down", "to the left"],
)
def test_normals_point_to_the_right_of_the_motion(stop, right):
    """y runs down the picture: whoever walks to the right has the lower edge on the right."""
    _, normal, _ = place_profiles(line((30.0, 30.0), stop))
    assert torch.allclose(normal[0], torch.tensor(right).double().expand_as(normal[0]), atol=1e-9)


def test_the_direction_is_that_of_the_motion():
    profiles = gathered(line((20.0, 30.0), (60.0, 50.0)))
    assert torch.allclose(
        profiles.direction, torch.full_like(profiles.position, math.atan2(20, 40)), atol=1e-9
    )


def test_an_arc_keeps_its_length_and_its_normals():
    radius = 40.0
    origin, normal, position = place_profiles(arc(radius))
    assert float(position[0, -1]) == pytest.approx(1.6 * radius, rel=1e-3)
    to_centre = torch.tensor([45.0, 60.0]) - origin[0]
    assert torch.allclose(to_centre.norm(dim=-1), torch.tensor(radius).double(), rtol=1e-3)
    inner = slice(3, -3)
    assert torch.allclose(normal[0][inner], (to_centre / radius)[inner], atol=3e-3)


def test_shapes():
    profiles = gathered(line((20.0, 30.0), (60.0, 30.0)))
    count, samples = profiles.position.shape[1], profiles.offset.shape[2]
    assert count == 41
    assert profiles.signal.shape == (1, count, samples, 1)
    assert profiles.ground.shape == profiles.variance.shape == profiles.signal.shape
    assert profiles.smooth_ground.shape == profiles.signal.shape
    assert profiles.valid.shape == profiles.is_filled.shape == (1, count, samples)
    assert profiles.signal.dtype == torch.float64


@pytest.mark.parametrize(
    "axis", [line((20.0, 30.0), (60.0, 30.0)), line((22.3, 24.8), (61.0, 46.4)), arc(40.0)]
)
def test_a_linear_ramp_comes_back_exactly(axis):
    """A pixel lies half a px from its profile's line at most, on the outside of a bend more."""
    profiles = gathered(axis)
    tangent = torch.stack([profiles.normal[..., 1], -profiles.normal[..., 0]], dim=-1)
    slope = torch.tensor([0.5, -0.25], dtype=torch.float64)
    expected = 3 + places(profiles) @ slope
    along = (profiles.signal[..., 0] - expected) / (tangent @ slope)[..., None]
    inner = profiles.is_filled[:, 1:-1]
    assert along[:, 1:-1][inner].abs().max() < 0.9
    assert along[:, 1:-1][inner].mean().abs() < 0.02


def test_pixels_on_an_axis_of_whole_px_are_met_exactly():
    profiles = gathered(line((20.0, 30.0), (60.0, 30.0)), reach=5.2)
    inner = profiles.is_filled & (profiles.position % 40 > 0.5)[..., None]
    assert (inner.sum(-1)[0, 1:-1] == 11).all()
    assert torch.allclose(
        profiles.offset[0, 7][inner[0, 7]], torch.arange(-5.0, 6.0).double(), atol=1e-6
    )
    slope = torch.tensor([0.5, -0.25], dtype=torch.float64)
    expected = 3 + places(profiles) @ slope
    assert torch.allclose(profiles.signal[..., 0][inner], expected[inner], atol=1e-6)
    assert torch.allclose(profiles.ground, 0.5 * profiles.signal)
    assert torch.allclose(profiles.variance, 0.01 * profiles.signal + 1e-4)
    # a 5 x 5 mean changes nothing of a ramp
    assert torch.allclose(profiles.smooth_ground[inner], profiles.ground[inner])


@pytest.mark.parametrize("axis", [line((22.3, 24.8), (61.0, 46.4)), arc(40.0)])
def test_every_pixel_about_the_axis_is_used_once(axis):
    numbers = torch.arange(WIDTH * HEIGHT).double().reshape(1, 1, HEIGHT, WIDTH)
    profiles = gather_profiles(observation(numbers), unclipped(numbers), axis, 10.0)
    used = profiles.signal[profiles.is_filled][:, 0]
    assert len(used.unique()) == len(used)
    y, x = torch.meshgrid(
        torch.arange(HEIGHT).double(), torch.arange(WIDTH).double(), indexing="ij"
    )
    distance = torch.cdist(torch.stack([x, y], -1).reshape(-1, 2), profiles.origin[0])
    nearest, at = distance.min(1)
    is_beside = (nearest < 9.5) & (at > 1) & (at < profiles.position.shape[1] - 2)
    assert set(is_beside.nonzero()[:, 0].tolist()) <= set(used.long().tolist())


def test_offsets_end_at_the_reach():
    profiles = gathered(line((22.3, 24.8), (61.0, 46.4)), reach=12.0)
    assert 11.0 < profiles.offset.abs().max() <= 12.0
    assert (profiles.offset[~profiles.is_filled] == 0).all()


def test_wider_spacing_and_fewer_profiles_hold_the_same_pixels():
    axis = line((22.3, 24.8), (61.0, 46.4))
    dense, wide = gathered(axis), gathered(axis, spacing=3.0)
    assert float(wide.position[0].diff().mean()) == pytest.approx(3.0, rel=0.05)
    pixels = [int(profiles.is_filled[:, 2:-2].sum()) for profiles in (dense, wide)]
    steps = [len(profiles.position[0]) - 4 for profiles in (dense, wide)]
    spacings = [float(profiles.position[0].diff().mean()) for profiles in (dense, wide)]
    per_px = [n / (k * px) for n, k, px in zip(pixels, steps, spacings, strict=True)]
    assert per_px[0] == pytest.approx(per_px[1], rel=0.01)
    few = gathered(axis, spacing=3.0, every=2)
    assert torch.equal(few.position, wide.position[:, ::2])
    shared = min(few.offset.shape[-1], wide.offset.shape[-1])
    assert torch.equal(few.offset[..., :shared], wide.offset[:, ::2, :shared])


def test_a_window_of_the_picture_gives_the_same_as_the_whole():
    axis = line((30.4, 30.0), (55.0, 38.0))
    left, top = 12, 9
    window = ramp(70, 55, left, top)
    whole = gathered(axis, reach=10.0)
    part = gather_profiles(observation(window), unclipped(window), axis, 10.0, corner=(left, top))
    assert torch.equal(part.origin, whole.origin)
    assert torch.allclose(part.offset, whole.offset)
    assert torch.equal(part.valid, whole.valid)
    # pixels at the same offset may stand in either order
    counted = [(p.signal[..., 0] * p.is_filled).sum(-1) for p in (part, whole)]
    assert torch.allclose(*counted)


def test_clipped_pixels_are_marked():
    picture = ramp()
    clipped = unclipped(picture)
    clipped[0, 0, 33, 40] = True
    axis = line((20.0, 30.0), (60.0, 30.0))
    profiles = gather_profiles(observation(picture), clipped, axis, 5.0)
    touched = profiles.is_filled & ~profiles.valid
    assert touched.nonzero().tolist() == [[0, 20, 8]]


def test_beyond_the_picture_there_is_nothing():
    profiles = gathered(line((20.0, 66.0), (60.0, 66.0)), reach=10.0)
    assert float(profiles.offset[profiles.is_filled].max()) == 3.0  # row 69 is the last
    assert float(profiles.offset[profiles.is_filled].min()) == -10.0
    assert not profiles.valid[~profiles.is_filled].any()


def test_pictures_of_a_batch_do_not_meet():
    one, two = ramp(), ramp(slope=(-0.1, 0.3))
    axes = [line((20.0, 30.0), (60.0, 30.0)), line((20.0, 20.0), (52.0, 44.0))]
    both = torch.cat([one, two])
    batch = gather_profiles(observation(both), unclipped(both), torch.cat(axes), 8.0)
    for index, (picture, axis) in enumerate(zip((one, two), axes, strict=True)):
        alone = gather_profiles(observation(picture), unclipped(picture), axis, 8.0)
        filled = alone.is_filled[0]
        places_in_batch = batch.is_filled[index]
        assert places_in_batch.sum() == filled.sum()
        assert torch.allclose(batch.signal[index][places_in_batch], alone.signal[0][filled])


def test_an_axis_for_each_picture_is_needed():
    picture = ramp()
    with pytest.raises(ShapeError, match="axis has shape"):
        gather_profiles(
            observation(picture),
            unclipped(picture),
            line((1.0, 1.0), (9.0, 9.0)).expand(2, -1, -1),
            5.0,
        )


@pytest.mark.parametrize("radius", [35.0, 60.0])
def test_the_bend_of_an_arc(radius):
    axis = arc(radius, centre=(45.0, radius + 10), angles=(-2.0, -1.1), count=200)
    profiles = gathered(axis, reach=5.0)
    bend = axis_bend(profiles)
    assert bend.shape == profiles.position.shape
    inner = slice(12, -12)
    # it bends towards its centre, which is on the right
    assert torch.allclose(bend[0][inner], torch.tensor(1 / radius).double(), rtol=0.03)
    back = axis_bend(gathered(axis.flip(1), reach=5.0))
    assert torch.allclose(back, -bend.flip(1), rtol=1e-3, atol=1e-5)


def test_a_straight_axis_does_not_bend():
    assert axis_bend(gathered(line((20.0, 30.0), (60.0, 45.0)))).abs().max() < 1e-9
