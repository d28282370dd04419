import pytest
import torch

from toolkit import Camera
from toolkit.outline import CAP_POINTS, outline
from toolkit.synthetic.paths import ParabolicPath, StraightPath
from toolkit.synthetic.truth import true_contours

RADIUS = 0.04
LENS = Camera.centred(1200, 900, 1500.0, distortion=(-0.2, 0.05, 0.001, -0.002))
PATHS = {
    "tilted": StraightPath(start=(-0.3, -0.1, 1.5), start_velocity=(0.5, 0.2, 0.4)),
    "short": StraightPath(start=(0.2, 0.1, 1.0), start_velocity=(0.01, -0.01, 0.01)),
    "bent": ParabolicPath(
        start=(-0.2, 0.1, 1.0), start_velocity=(0.5, -0.6, -0.2), acceleration=(0.0, 1.2, 0.0)
    ),
}


def time(count: int) -> torch.Tensor:
    return torch.linspace(0, 1, count, dtype=torch.float64)


def drawn(path, count: int = 41) -> torch.Tensor:
    """Both sides [2, M, 2]."""
    t = time(count)
    return torch.stack(outline(path.position(t), path.velocity(t), LENS, RADIUS))


def nearest(path, pixels: torch.Tensor) -> torch.Tensor:
    """How near the ball's centre comes to each pixel's ray, in ball radii."""
    rays = LENS.unproject(pixels.reshape(-1, 1, 2))
    gap = torch.linalg.cross(path.position(time(4001))[None], rays.expand(-1, 4001, 3))
    return (torch.linalg.vector_norm(gap, dim=-1).amin(-1) / RADIUS).reshape(pixels.shape[:-1])


@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
def test_every_ray_of_the_outline_grazes_the_ball_once(path):
    gaps = nearest(path, drawn(path))
    torch.testing.assert_close(gaps, torch.ones_like(gaps), atol=1e-5, rtol=0)


@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
def test_its_middle_is_the_contours_of_the_tube(path):
    between = drawn(path)[:, CAP_POINTS:-CAP_POINTS]
    torch.testing.assert_close(between, true_contours(path, LENS, RADIUS, 1.0, 41))


@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
def test_both_sides_start_and_end_at_the_tips(path):
    sides = drawn(path)
    torch.testing.assert_close(sides[0, [0, -1]], sides[1, [0, -1]])
    # nothing is skipped from the tips to the tube: its own points lie farther apart here
    steps = torch.linalg.vector_norm(sides.diff(dim=1), dim=-1)
    for cap in (steps[:, :CAP_POINTS], steps[:, -CAP_POINTS:]):
        assert float(cap.max()) < 1.5 * float(cap.median())


def test_the_left_side_is_above_a_ball_that_goes_right():
    left, right = drawn(PATHS["tilted"])
    assert (left[1:-1, 1] < right[1:-1, 1]).all()


def test_a_still_ball_is_its_limb():
    still = StraightPath(start=(0.1, 0.2, 1.0), start_velocity=(0.0, 0.0, 0.0))
    sides = drawn(still, count=3)
    torch.testing.assert_close(nearest(still, sides), torch.ones_like(sides[..., 0]))
    middle = LENS.project(torch.tensor([0.1, 0.2, 1.0], dtype=torch.float64))
    arms = sides.reshape(-1, 2) - middle
    angles = torch.atan2(arms[:, 1], arms[:, 0]).sort().values
    assert float(angles.diff().max()) < 0.2


def test_a_ball_that_comes_straight_on_is_its_nearest_limb():
    coming = StraightPath(start=(0.0, 0.0, 2.0), start_velocity=(0.0, 0.0, -1.0))
    sides = drawn(coming)
    assert torch.isfinite(sides).all()
    last = StraightPath(start=(0.0, 0.0, 1.0), start_velocity=(0.0, 0.0, 0.0))
    assert float(nearest(last, sides).max()) < 1 + 1e-9
    gaps = nearest(last, sides[:, -CAP_POINTS:])
    torch.testing.assert_close(gaps, torch.ones_like(gaps))
