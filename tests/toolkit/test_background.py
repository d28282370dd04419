from dataclasses import replace

import pytest
import torch

from toolkit.background import (
    brightness_drift,
    check_pair,
    estimate_noise,
    sample_pair,
    scale_background,
)
from toolkit.errors import MismatchError
from toolkit.synthetic import NoiseLevel, add_noise, textured_background
from toolkit.types import LinearImage

WIDTH, HEIGHT = 240, 240  # few enough that every pixel counts
BAYER = ((0, 1), (1, 2))
RAMP = torch.linspace(-0.25, 0.25, WIDTH)
SCENE = textured_background(WIDTH, HEIGHT, colour=(0.4, 0.35, 0.45), contrast=0.08, seed=1) + RAMP
FLAT = torch.full((3, HEIGHT, WIDTH), 0.1)
NONE = NoiseLevel()


def record(light, noise, seed, stream=0, frames=1):
    """A picture of known light [3, H, W] whose noise is that of `frames` averaged ones."""
    rgb = torch.stack([add_noise(light, noise, seed * 100 + n, stream) for n in range(frames)])
    rgb = rgb.mean(0, keepdim=True)
    return LinearImage(rgb=rgb, clipped=(rgb >= 1).any(1, keepdim=True), frames=frames)


def pair(noise, seed=0, light=SCENE, ground=SCENE, frames=1):
    return record(light, noise, seed, 0), record(ground, noise, seed, 1, frames)


def with_mosaic(image, pattern=BAYER):
    """Behind a colour mosaic; what is interpolated from it is made smooth and useless here."""
    channel = torch.tensor(pattern).repeat(HEIGHT // 2, WIDTH // 2)[None, None]
    mosaic = image.rgb.gather(1, channel)
    smooth = torch.nn.functional.avg_pool2d(image.rgb, 9, stride=1, padding=4)
    return replace(image, rgb=smooth, mosaic=mosaic, pattern=pattern)


def with_ball(image, share=0.1):
    """Cover a share of the picture with an opaque ball."""
    rgb = image.rgb.clone()
    rgb[..., : int(share * WIDTH)] = torch.tensor([0.9, 0.6, 0.2])[:, None, None]
    ignore = torch.zeros_like(image.clipped)
    ignore[..., : int(share * WIDTH)] = True
    return replace(image, rgb=rgb), ignore


def level_of(model, level):
    """Standard deviation at a level, per channel, of raw samples."""
    return (model.read_variance + model.gain * level).sqrt()[0]


@pytest.mark.parametrize("seed", range(3))
def test_read_noise_and_gain_come_back(seed):
    model = estimate_noise(*pair(NoiseLevel(read=0.012, gain=3e-4), seed))
    assert model.read_variance.shape == (1, 3)
    assert model.gain.shape == (1, 3)
    assert torch.allclose(model.gain, torch.tensor(3e-4), rtol=0.12)
    assert torch.allclose(model.read_variance.sqrt(), torch.tensor(0.012), rtol=0.08)
    for level in (0.2, 0.4, 0.6):
        expected = torch.tensor((0.012**2 + 3e-4 * level) ** 0.5)
        assert torch.allclose(level_of(model, level), expected, rtol=0.02)


@pytest.mark.parametrize(
    "noise", [NoiseLevel(read=0.01), NoiseLevel(read=0.0002, gain=2e-4)], ids=["read", "shot"]
)
def test_one_kind_of_noise_alone(noise):
    model = estimate_noise(*pair(noise))
    for level in (0.2, 0.4, 0.6):
        expected = torch.tensor((noise.read**2 + noise.gain * level) ** 0.5)
        assert torch.allclose(level_of(model, level), expected, rtol=0.03)
    assert (model.read_variance > 0).all()
    assert (model.gain >= 0).all()


def test_the_variance_is_given_at_every_level():
    model = estimate_noise(*pair(NoiseLevel(read=0.01, gain=2e-4)))
    level = torch.stack([torch.full((2, 5), value) for value in (-0.1, 0.3, 0.6)])[None]
    variance = model.variance(level)
    assert variance.shape == (1, 3, 2, 5)
    assert torch.allclose(variance[0, 0], model.read_variance[0, 0].expand(2, 5))
    expected = model.read_variance[0, 2] + model.gain[0, 2] * 0.6
    assert torch.allclose(variance[0, 2], expected.expand(2, 5))


def test_averaged_backgrounds_are_accounted_for():
    shot, ground = pair(NoiseLevel(read=0.012, gain=3e-4), frames=5)
    model = estimate_noise(shot, ground)
    expected = torch.tensor((0.012**2 + 3e-4 * 0.4) ** 0.5)
    assert torch.allclose(level_of(model, 0.4), expected, rtol=0.02)


def test_a_still_scene_has_the_least_noise_a_camera_can_have():
    model = estimate_noise(*pair(NONE))
    assert torch.allclose(level_of(model, 0.4), torch.tensor(2e-5), rtol=0.01)


@pytest.mark.parametrize("is_told", [True, False])
def test_a_ball_over_a_tenth_of_the_picture_changes_little(is_told):
    shot, ground = pair(NoiseLevel(read=0.012, gain=3e-4))
    shot, ignore = with_ball(shot)
    model = estimate_noise(shot, ground, ignore if is_told else None)
    expected = torch.tensor((0.012**2 + 3e-4 * 0.4) ** 0.5)
    assert torch.allclose(level_of(model, 0.4), expected, rtol=0.02 if is_told else 0.25)


def test_drift_does_not_count_as_noise():
    noise = NoiseLevel(read=0.005)
    model = estimate_noise(*pair(noise, light=1.04 * FLAT, ground=FLAT))
    assert torch.allclose(level_of(model, 0.1), torch.tensor(0.005), rtol=0.02)


def test_noise_behind_a_mosaic_is_read_from_raw_samples():
    shot, ground = (with_mosaic(image) for image in pair(NoiseLevel(read=0.012, gain=3e-4)))
    model = estimate_noise(shot, ground)
    expected = torch.tensor((0.012**2 + 3e-4 * 0.4) ** 0.5)
    assert torch.allclose(level_of(model, 0.4), expected, rtol=0.04)
    assert model.density.tolist() == [0.25, 0.5, 0.25]
    # each interpolated sample stands for a share of a raw one
    level = torch.full((1, 3, 1, 1), 0.4)
    expected = level_of(model, 0.4) ** 2 / model.density
    assert torch.allclose(model.variance(level).flatten(), expected)


def test_without_a_mosaic_on_both_sides_the_colours_are_compared():
    shot, ground = pair(NoiseLevel(read=0.01))
    model = estimate_noise(with_mosaic(shot), ground)
    assert model.density.tolist() == [1.0, 1.0, 1.0]


def test_clipped_pixels_are_left_out():
    noise = NoiseLevel(read=0.02)
    light = SCENE.clone()
    light[:, : HEIGHT // 2] = 0.999
    model = estimate_noise(*pair(noise, light=light, ground=light))
    assert torch.allclose(level_of(model, 0.3), torch.tensor(0.02), rtol=0.05)


@pytest.mark.parametrize("drift", [(1.01, 1.01, 1.01), (0.99, 1.0, 1.01), (1.08, 1.04, 0.95)])
def test_drift_comes_back_per_channel(drift):
    change = torch.tensor(drift)
    light = SCENE * change[:, None, None]
    found = brightness_drift(*pair(NoiseLevel(read=0.01), light=light))
    assert found.shape == (3,)
    assert torch.allclose(found.float(), change, atol=1.5e-3)


@pytest.mark.parametrize("scene", [SCENE, FLAT], ids=["textured", "flat and dark"])
@pytest.mark.parametrize("read", [0.01, 0.03])
def test_without_drift_none_is_found(scene, read):
    """Noise makes some pixels bright in one picture alone; they must not be chosen by that."""
    drifts = [
        brightness_drift(*pair(NoiseLevel(read=read), seed, light=scene, ground=scene))
        for seed in range(4)
    ]
    bright_samples = WIDTH * HEIGHT / 2 / 2
    std = 1.25 * 2**0.5 * read / float(scene.mean()) / bright_samples**0.5
    assert (torch.stack(drifts).mean(0) - 1).abs().max() < 4 * std / 2
    assert std < 0.005


def test_the_drift_errs_by_as_much_as_it_says():
    samples = [sample_pair(*pair(NoiseLevel(read=0.02), seed=seed)) for seed in range(30)]
    found = [one.drift_and_std() for one in samples]
    sigmas = torch.cat([(drift - 1) / std for drift, std in found])
    assert 0.8 < float(sigmas.square().mean().sqrt()) < 1.25


def test_drift_behind_a_mosaic():
    light = SCENE * torch.tensor([1.02, 1.0, 0.97])[:, None, None]
    shot, ground = (with_mosaic(image) for image in pair(NoiseLevel(read=0.005), light=light))
    found = brightness_drift(shot, ground).float()
    assert torch.allclose(found, torch.tensor([1.02, 1.0, 0.97]), atol=2e-3)


def test_drift_ignores_the_ball():
    shot, ground = pair(NoiseLevel(read=0.005), light=1.02 * SCENE)
    shot, ignore = with_ball(shot, share=0.3)
    found = brightness_drift(shot, ground, ignore).float()
    assert torch.allclose(found, torch.tensor(1.02), atol=1.5e-3)


def test_the_background_follows_the_drift():
    ratio = torch.tensor([1.1, 1.0, 0.9], dtype=torch.float64)
    _, ground = pair(NONE)
    scaled = scale_background(ground, ratio)
    assert torch.allclose(scaled.rgb[0, 0], 1.1 * ground.rgb[0, 0])
    assert torch.equal(scaled.rgb[0, 1], ground.rgb[0, 1])
    assert scaled.rgb.dtype == torch.float32
    assert torch.equal(scaled.clipped, ground.clipped)


def test_a_mosaic_follows_the_drift_at_each_pixel_for_its_colour():
    ratio = torch.tensor([1.1, 1.0, 0.9], dtype=torch.float64)
    ground = with_mosaic(pair(NONE)[1])
    scaled = scale_background(ground, ratio)
    expected = (ratio[:, None, None] * ground.measured()).sum(1, keepdim=True) * ground.mosaic
    assert torch.allclose(scaled.mosaic.double(), expected)
    assert torch.equal((scaled.rgb * scaled.measured()).sum(1), scaled.mosaic[:, 0])


@pytest.mark.parametrize("light", [0.5, 1.5])
def test_a_scaled_background_has_its_own_noise(light):
    """Else the shot's noise would be taken for as large as the one that was scaled with it."""
    shot, ground = pair(NoiseLevel(read=0.01), ground=light * SCENE)
    scaled = scale_background(ground, torch.full((3,), 1 / light, dtype=torch.float64))
    assert scaled.frames == pytest.approx(light**2)
    model = estimate_noise(shot, scaled)
    assert torch.allclose(level_of(model, 0.3), torch.tensor(0.01), rtol=0.05)


def test_pictures_of_other_sizes_are_refused():
    shot, ground = pair(NONE)
    check_pair(shot, ground)
    small = replace(ground, rgb=ground.rgb[..., :100], clipped=ground.clipped[..., :100])
    with pytest.raises(MismatchError, match=r"background is 100x240 px but the shot is 240x240 px"):
        check_pair(shot, small)
