import math

import numpy as np
import pytest
import torch
from sweep_scenes import draw_scene, render
from sweep_violations import (
    DEFOCUS_PX,
    VIOLATIONS,
    PrintedBall,
    _disc,
    defocus,
    jpeg,
    report,
    shifted,
)

from toolkit.synthetic import NoiseLevel

SEED = 5


@pytest.fixture(scope="module")
def scene():
    return draw_scene(SEED)


@pytest.fixture(scope="module")
def shot(scene):
    return render(scene, SEED)


def drawn(shot):
    return lambda scene, seed: shot


def test_the_print_covers_a_tenth_of_the_face():
    ball = PrintedBall(colour=(0.8, 0.8, 0.8), middle=(0.0, 0.0, -1.0))
    line = torch.linspace(-1, 1, 401)
    x, y = torch.meshgrid(line, line, indexing="xy")
    x, y = (a[x * x + y * y < 1] for a in (x, y))
    normal = torch.stack([x, y, -(1 - x * x - y * y).clamp_min(0).sqrt()], dim=-1)
    share = float((ball(normal, 0.0)[:, 0] < 0.5).float().mean())
    assert share == pytest.approx(0.1, abs=0.02)


def test_the_print_turns_with_the_ball():
    spin = (0.0, math.pi / 0.02, 0.0)
    ball = PrintedBall(colour=(0.8, 0.8, 0.8), middle=(0.0, 0.0, -1.0), spin=spin)
    line = torch.linspace(-0.4, 0.4, 81)
    x, y = (a.flatten() for a in torch.meshgrid(line, line, indexing="xy"))
    front = torch.stack([x, y, -(1 - x * x - y * y).sqrt()], dim=-1)
    assert (ball(front, 0.0)[:, 0] < 0.5).any()
    assert not (ball(front, 0.02)[:, 0] < 0.5).any()  # half a turn later
    back = front * torch.tensor([-1.0, 1.0, -1.0])
    assert torch.equal(ball(back, 0.02), ball(front, 0.0))


def test_defocus_spreads_light_over_a_disc_and_keeps_it():
    disc = _disc(DEFOCUS_PX)
    offset = np.arange(len(disc)) - len(disc) // 2
    assert disc.sum() == pytest.approx(1)
    # a quarter of the squared radius, and a little that pixels add
    assert 1.5**2 / 4 < (disc.sum(axis=0) * offset**2).sum() < 1.5**2 / 4 + 1 / 6


def test_only_the_ball_is_out_of_focus(scene, shot):
    seen = defocus(scene, SEED, drawn(shot))
    assert torch.equal(seen.shot.clean_background, shot.clean_background)
    change = seen.shot.clean_image - shot.clean_image
    assert change.abs().max() > 0.005
    # the disc and then the sum of 32-bit numbers
    assert change.sum(dim=(1, 2)).abs().max() < 2e-3 * shot.clean_image.sum()


def test_the_background_is_shifted_by_what_is_told(scene, shot):
    seen = shifted(scene, SEED, drawn(shot)).shot
    ground, moved = (s.clean_background.double() for s in (shot, seen))
    y, x = (torch.gradient(ground, dim=d)[0] for d in (1, 2))
    slopes = torch.stack([x[:, 3:-3, 3:-3].flatten(), y[:, 3:-3, 3:-3].flatten()], dim=-1)
    change = (ground - moved)[:, 3:-3, 3:-3].flatten()
    shift = torch.linalg.lstsq(slopes, change[:, None]).solution
    assert float(shift.norm()) == pytest.approx(0.3, rel=0.1)
    assert torch.equal(seen.clean_image, shot.clean_image)


def test_a_jpeg_looks_nearly_the_same(scene, shot):
    quiet = shot.with_noise(SEED, NoiseLevel())
    seen = jpeg(scene, SEED, drawn(quiet))
    assert seen.image.response == "srgb"
    error = (seen.image.rgb - quiet.image.rgb).abs()
    assert 1e-4 < float(error.mean()) < 0.01


def row(violation, error, *cautions, seed=1):
    return {
        "violation": violation,
        "seed": seed,
        "refused": None,
        "error": [error, 0, 0, 0],
        "std": [1, 1, 1, 1],
        "cautions": list(cautions),
    }


def test_the_report_tells_telling_cautions_from_common_ones():
    rows = [row("clean", 0, "common") for _ in range(10)]
    rows += [row("gamma", 1), row("gamma", 4, "common"), row("gamma", 4, "misfit")]
    rows += [{"violation": "gamma", "refused": "too 1"}]
    line = next(line for line in report(rows).splitlines() if line.startswith("gamma"))
    assert line.split()[1:5] == ["3/4", "0.33", "0.33", "0.75"]
    assert "misfit 0.33 (0.00)" in line
    assert "common 0.33 (1.00)" in line
    assert "1 x gamma: too #" in report(rows)


def test_every_violation_has_its_line():
    rows = [row(name, 0) for name in VIOLATIONS]
    assert len(report(rows).splitlines()) == 1 + len(VIOLATIONS)
