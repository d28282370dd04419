from dataclasses import replace

import pytest
import torch

from toolkit.axis_curve import Edges
from toolkit.camera import Camera
from toolkit.ends import Ends
from toolkit.flight import (
    DURATION,
    SIZE,
    Flight,
    Sightings,
    crossing_opacity,
    fit_flight,
    levelled,
    see_ends,
    start_flight,
    with_known_opacity,
)
from toolkit.motion import OpacityData
from toolkit.synthetic import true_contours
from toolkit.synthetic.paths import ParabolicPath

BALL_RADIUS = 0.05
EXPOSURE = 0.02
PROFILES = 150
EDGE_STD, OPACITY_STD, END_STD = 0.1, 0.002, 0.2
"""px, share, px."""
CAMERA = Camera(
    width=1000,
    height=800,
    fx=900.0,
    fy=910.0,
    cx=505.0,
    cy=395.0,
    distortion=(-0.12, 0.05, 1e-3, -8e-4, 0.01),
)
LEVEL = ParabolicPath(
    start=(-0.3, 0.1, 1.4), start_velocity=(30.0, -10.0, 5.0), acceleration=(0.0, 950.0, 0.0)
)
DEEP = replace(LEVEL, acceleration=(0.0, 950.0, 600.0))
TIME = torch.tensor([-0.4, -0.1, 0.0, 0.25, 0.45], dtype=torch.float64)


def flight_of(path):
    """The path, counted in exposures from the middle."""
    middle = torch.tensor([EXPOSURE / 2], dtype=torch.float64)
    bend = torch.tensor(path.acceleration, dtype=torch.float64) * EXPOSURE**2 / 2
    return Flight(
        coefficients=torch.stack(
            [path.position(middle)[0], path.velocity(middle)[0] * EXPOSURE, bend]
        )
    )


def sightings(path, generator=None, dimming=1.0):
    """What is seen of a path, with noise when a generator is given."""
    flight = flight_of(path)

    def noise(*shape):
        if generator is None:
            return torch.zeros(shape, dtype=torch.float64)
        return torch.randn(shape, generator=generator, dtype=torch.float64)

    pixels = true_contours(path, CAMERA, BALL_RADIUS, EXPOSURE, PROFILES).transpose(0, 1)
    time = torch.linspace(-0.5, 0.5, PROFILES, dtype=torch.float64)
    normal = torch.nn.functional.normalize(pixels[:, 1] - pixels[:, 0], dim=-1)
    rays = CAMERA.unproject(pixels.mean(1))
    opacity, _ = crossing_opacity(flight, time, rays, BALL_RADIUS)
    centre, half = (EDGE_STD * noise(PROFILES, 2)).unbind(-1)
    sides = torch.stack([centre - half, centre + half], dim=-1)
    variances = torch.tensor([EDGE_STD, EDGE_STD, OPACITY_STD], dtype=torch.float64) ** 2
    covariance = torch.diag(variances).expand(PROFILES, 3, 3)
    weight = torch.ones(PROFILES, dtype=torch.float64)
    half_exposure = torch.tensor([-0.5, 0.5], dtype=torch.float64)
    ends = Ends(s=half_exposure, std=torch.ones(2), chi2_per_dof=1.0)
    end, along, _ = see_ends(flight, ends, CAMERA)
    return Sightings(
        edges=Edges(
            s=time,
            pixels=pixels + sides[..., None] * normal[:, None],
            normal=normal,
            covariance=covariance[:, :2, :2],
            weight=weight,
        ),
        opacity=OpacityData(
            s=time,
            rays=rays,
            opacity=dimming * opacity + OPACITY_STD * noise(PROFILES),
            covariance=covariance,
            weight=weight,
        ),
        time=time + 0.03,
        end=end + END_STD * noise(2, 1) * along,
        end_along=along,
        end_std=torch.full((2,), END_STD, dtype=torch.float64),
    )


def rough(path):
    """A start some way off."""
    return Flight(
        coefficients=flight_of(path).coefficients * torch.tensor([1.03, 0.97, 0.8])[:, None]
    )


def test_shapes():
    flight = flight_of(LEVEL)
    assert flight(TIME).shape == (5, 3)
    assert flight.tangent(TIME[:, None].expand(5, 2)).shape == (5, 2, 3)
    assert flight.J_point(TIME).shape == (5, 3, SIZE)
    opacity, J = crossing_opacity(flight, TIME, flight(TIME), BALL_RADIUS)
    assert opacity.shape == (5,)
    assert J.shape == (5, SIZE)


def test_a_flight_is_the_parabola():
    clock = (TIME + 0.5) * EXPOSURE
    assert torch.allclose(flight_of(DEEP)(TIME), DEEP.position(clock))
    assert torch.allclose(flight_of(DEEP).tangent(TIME), DEEP.velocity(clock) * EXPOSURE)


def test_J_point_is_the_derivative_in_the_coefficients():
    flight = flight_of(DEEP)
    expected = torch.func.jacrev(lambda c: Flight(coefficients=c.reshape(3, 3))(TIME))(
        flight.coefficients.flatten()
    )
    assert torch.allclose(flight.J_point(TIME), expected)


def test_the_opacity_is_the_share_of_time_on_the_ray():
    flight = flight_of(DEEP)
    rays = torch.nn.functional.normalize(flight(TIME), dim=-1)
    opacity, _ = crossing_opacity(flight, TIME + 0.02, rays, BALL_RADIUS)
    fine = torch.linspace(-1, 1, 400_001, dtype=torch.float64)
    for ray, found in zip(rays, opacity, strict=True):
        away = torch.linalg.cross(flight(fine), ray.expand(len(fine), 3)).norm(dim=-1)
        share = float((away <= BALL_RADIUS).sum()) * 2 / len(fine)
        assert float(found) == pytest.approx(share, rel=2e-3)


def test_the_opacity_s_jacobian():
    flight = flight_of(DEEP)
    rays = torch.nn.functional.normalize(flight(TIME), dim=-1)
    _, J = crossing_opacity(flight, TIME, rays, BALL_RADIUS)
    for index in range(SIZE):
        step = torch.zeros(SIZE, dtype=torch.float64)
        step[index] = 1e-6
        ahead, behind = (
            crossing_opacity(
                Flight(coefficients=flight.coefficients + sign * step.reshape(3, 3)),
                TIME,
                rays,
                BALL_RADIUS,
            )[0]
            for sign in (1, -1)
        )
        # the derivative leaves out how the small correction for bending changes
        assert torch.allclose(J[:, index], (ahead - behind) / 2e-6, atol=0.01 * J.abs().max())


def test_a_flight_starts_from_its_own_path():
    fit = fit_flight(rough(DEEP), sightings(DEEP), CAMERA, BALL_RADIUS)
    again = start_flight(fit.motion())
    assert torch.allclose(again.coefficients, fit.flight.coefficients)


@pytest.mark.parametrize("path", [LEVEL, DEEP], ids=["level", "with depth"])
def test_a_parabola_comes_back_exactly(path):
    fit = fit_flight(rough(path), sightings(path), CAMERA, BALL_RADIUS)
    assert fit.converged
    assert fit.chi2 < 1e-3
    assert float(fit.duration) == pytest.approx(1, abs=1e-4)
    gap = fit.motion().path - flight_of(path)(torch.linspace(-0.5, 0.5, 41).double())
    assert float(gap.norm(dim=-1).max()) < 1e-3 * BALL_RADIUS


def test_errors_are_as_large_as_the_covariance_says():
    generator = torch.Generator().manual_seed(2)
    truth = flight_of(DEEP).coefficients.flatten()
    distances, durations = [], []
    for _ in range(40):
        free = fit_flight(rough(DEEP), sightings(DEEP, generator), CAMERA, BALL_RADIUS)
        fit = with_known_opacity(free)
        error = fit.flight.coefficients.flatten() - truth
        information = torch.linalg.inv(fit.covariance[:SIZE, :SIZE])
        distances.append(float(error @ information @ error))
        durations.append(float((fit.duration - 1) / fit.covariance[DURATION, DURATION].sqrt()))
    assert sum(distances) / 40 == pytest.approx(SIZE, abs=2)  # 0.67 each
    assert torch.tensor(durations).std() == pytest.approx(1, abs=0.35)


def test_a_wrong_colour_shows_in_the_duration_alone():
    fit = fit_flight(rough(LEVEL), sightings(LEVEL, dimming=1.1), CAMERA, BALL_RADIUS)
    assert float(fit.duration) == pytest.approx(1.1, abs=1e-3)
    assert torch.allclose(fit.flight.coefficients, flight_of(LEVEL).coefficients, atol=1e-4)


def test_a_known_opacity_sharpens_the_speed():
    free = fit_flight(rough(LEVEL), sightings(LEVEL), CAMERA, BALL_RADIUS)
    known = with_known_opacity(free)
    assert (known.covariance.diagonal() <= free.covariance.diagonal() * (1 + 1e-9)).all()
    assert known.state_covariance()[6, 6] < 0.9 * free.state_covariance()[6, 6]
    assert known.duration == free.duration


@pytest.mark.parametrize(("path", "is_level"), [(LEVEL, True), (DEEP, False)])
def test_acceleration_along_the_line_of_sight_is_kept_where_it_shows(path, is_level):
    generator = torch.Generator().manual_seed(3)
    free = fit_flight(rough(path), sightings(path, generator), CAMERA, BALL_RADIUS)
    fit = levelled(with_known_opacity(free))
    assert fit.is_level == is_level
    sight = torch.nn.functional.normalize(fit.flight.coefficients[0], dim=0)
    along = float(fit.flight.coefficients[2] @ sight)
    assert (abs(along) < 1e-4) == is_level  # m per exposure^2; 0.12 of them along z in DEEP
    assert levelled(free, is_level=False) is free
