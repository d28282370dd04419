from dataclasses import replace

import pytest
import torch

from toolkit.sweep.cells import Cells
from toolkit.sweep.likelihood import compare

COUNT, VARIANCE = 7, 0.02


@pytest.fixture(scope="module")
def seen(streak):
    """A comparison a little off the truth, and cells of a few columns each."""
    one = streak()
    model, pixels = one.model(), one.pixels()
    x = one.truth()
    x[2] *= 1.001
    x[4] += 1e-4
    plain = compare(model, x, pixels)
    share = torch.linspace(1, 2, len(pixels), dtype=torch.float64)
    number = (pixels.place[:, 0] / 5).long() % COUNT
    return (
        model,
        x,
        pixels,
        plain,
        Cells(number=number, count=COUNT, share=share, variance=VARIANCE),
    )


def whole(plain, cells):
    """The equations with one more unknown for each cell, and its prior [P + K]."""
    P = len(plain.gradient)
    weight = plain.weight
    information = torch.zeros(P + COUNT, P + COUNT, dtype=torch.float64)
    gradient = torch.zeros(P + COUNT, dtype=torch.float64)
    information[:P, :P], gradient[:P] = plain.information, plain.gradient
    for q, (J, at) in enumerate(zip(plain.J, plain.columns, strict=True)):
        for k in range(COUNT):
            light = weight[q] * plain.light[q] * cells.share * (cells.number == k)
            information[P + k, P + k] += light @ light
            information[at, P + k] += J @ light
            information[P + k, at] += J @ light
            gradient[P + k] -= light @ (weight[q] * plain.residual[q])
    information.diagonal()[P:] += 1 / VARIANCE
    return information, gradient


def test_freed_equations_are_those_of_all_lights_fitted_too(seen):
    _, _, _, plain, cells = seen
    P = len(plain.gradient)
    information, gradient = whole(plain, cells)
    freed = cells.freed(plain)
    left = torch.linalg.inv(torch.linalg.inv(information)[:P, :P])
    scale = left.diagonal().sqrt()
    assert ((freed.information - left) / torch.outer(scale, scale)).abs().max() < 1e-8
    step = torch.linalg.solve(information, -gradient)
    assert torch.allclose(freed.step()[0], step[:P], rtol=1e-5, atol=1e-9)
    assert plain.cost - freed.cost == pytest.approx(
        float(gradient[P:] @ (gradient[P:] / information.diagonal()[P:])), rel=1e-9
    )


def test_a_change_of_the_picture_is_answered_with_the_lights_let_free(seen):
    model, _, pixels, plain, cells = seen
    plain = compare(model, seen[1], pixels, huber=1e9)
    plain = replace(plain, residual=plain.residual.clamp(-3, 3))  # all of which count in full
    P, change = len(plain.gradient), torch.zeros_like(plain.residual)
    change[1] = torch.linspace(-1, 1, change.shape[1], dtype=torch.float64)
    information, _ = whole(plain, cells)
    pull = torch.zeros(P + COUNT, dtype=torch.float64)
    for q, (J, at) in enumerate(zip(plain.J, plain.columns, strict=True)):
        pull[at] += J @ change[q]
        light = plain.weight[q] * plain.light[q] * cells.share
        pull[P:].index_add_(0, cells.number, light * change[q])
    expected = torch.linalg.solve(information, pull)[:P]
    assert torch.allclose(cells.freed(plain).answer(change), expected, rtol=1e-4, atol=1e-9)


def test_a_model_with_cells_compares_with_them_freed(seen):
    model, x, pixels, plain, cells = seen
    found = compare(replace(model, cells=cells), x, pixels)
    assert found.cost == pytest.approx(cells.freed(plain).cost)
    assert torch.equal(found.gradient, cells.freed(plain).gradient)


def test_the_least_cost_is_at_the_lights_that_are_there(seen):
    """Lights of a fifth, laid on the picture: the restricted likelihood tells them apart."""
    _, _, _, plain, cells = seen
    lights = 0.2 * torch.randn(COUNT, generator=torch.Generator().manual_seed(2)).double()
    quiet = torch.randn(plain.residual.shape, generator=torch.Generator().manual_seed(3)).double()
    at = replace(plain, residual=quiet + plain.light * cells.share * lights[cells.number])
    at = replace(at, gradient=_gradient(at))
    sums = cells.sums(at)
    costs = {std: sums.cost(at, std**2) for std in (0.005, 0.02, 0.2, 2.0)}
    assert min(costs, key=costs.get) == 0.2
    assert costs[0.005] > costs[0.2] + 20
    calm = replace(plain, residual=quiet)
    calm = replace(calm, gradient=_gradient(calm))
    assert cells.sums(calm).cost(calm, 1e-12) < cells.sums(calm).cost(calm, 0.04)


def _gradient(seen):
    gradient = torch.zeros_like(seen.gradient)
    for q, (J, at) in enumerate(zip(seen.J, seen.columns, strict=True)):
        gradient[at] -= J @ (seen.weight[q] * seen.residual[q])
    return gradient


def test_merged_sums_are_those_of_larger_cells(seen):
    _, _, _, plain, cells = seen
    number = torch.tensor([0, 0, 1, 1, 2, 2, 2])
    merged = cells.sums(plain).merged(number, 3)
    number = number[cells.number]
    larger = Cells(number=number, count=3, share=cells.share, variance=VARIANCE).sums(plain)
    assert torch.allclose(merged.pull, larger.pull)
    assert torch.allclose(merged.hold, larger.hold)
    assert torch.allclose(merged.shared, larger.shared)
