import pytest
import torch

from toolkit.errors import ConfigError
from toolkit.synthetic import NoiseLevel, add_noise

LEVELS = torch.tensor([0.0, 0.1, 0.4, 0.7])[:, None].expand(4, 200_000)


def test_variance_is_read_noise_plus_gain_times_light():
    noisy = add_noise(LEVELS, NoiseLevel(read=0.004, gain=2e-4), seed=1)
    expected = 0.004**2 + 2e-4 * LEVELS[:, 0]
    # the relative error of a variance from n samples is sqrt(2 / n), 0.3 % here
    assert torch.allclose(noisy.double().var(dim=1), expected.double(), rtol=0.015)
    assert torch.allclose(noisy.double().mean(dim=1), LEVELS[:, 0].double(), atol=1e-4)


def test_noise_without_gain_is_the_same_at_every_level_and_goes_below_zero():
    noisy = add_noise(LEVELS, NoiseLevel(read=0.01), seed=1)
    assert torch.allclose(noisy.double().std(dim=1), torch.tensor(0.01).double(), rtol=0.01)
    assert noisy[0].min() < -0.02


def test_light_is_cut_at_white():
    assert add_noise(torch.full((1000,), 0.99), NoiseLevel(read=0.1), seed=0).max() == 1


def test_no_noise_changes_nothing():
    assert torch.equal(add_noise(LEVELS, NoiseLevel(), seed=3), LEVELS)


def test_a_seed_repeats_and_streams_differ():
    noise = NoiseLevel(read=0.01, gain=1e-4)
    first = add_noise(LEVELS, noise, seed=5)
    assert torch.equal(first, add_noise(LEVELS, noise, seed=5))
    for other in (add_noise(LEVELS, noise, seed=6), add_noise(LEVELS, noise, seed=5, stream=1)):
        pair = torch.stack([(first - LEVELS)[2], (other - LEVELS)[2]])
        assert torch.corrcoef(pair)[0, 1].abs() < 0.01


@pytest.mark.parametrize("values", [{"read": -0.1}, {"gain": 1.5}, {"read": float("nan")}])
def test_impossible_noise_is_refused(values):
    with pytest.raises(ConfigError, match="must lie in"):
        NoiseLevel(**values)
