import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from toolkit import LinearImage, MismatchError, read_background, read_image
from toolkit.scene_match import check_light, check_same_scene
from toolkit.synthetic import NoiseLevel, add_noise, flat_background, textured_background

WIDTH, HEIGHT = 320, 240  # suits the Fourier transform: OpenCV then works in its input's place
STREAKS = Path(__file__).resolve().parents[2].parent / "shared/data/streaks"
SCENE = textured_background(WIDTH, HEIGHT, contrast=0.15, seed=3)
BAYER = ((0, 1), (1, 2))


def picture(light, stream=0, noise=0.004):
    rgb = add_noise(light, NoiseLevel(read=noise), 5, stream)[None]
    return LinearImage(rgb=rgb, clipped=torch.zeros(1, 1, HEIGHT, WIDTH, dtype=torch.bool))


def with_mosaic(image):
    channel = torch.tensor(BAYER).repeat(HEIGHT // 2, WIDTH // 2)[None, None]
    return replace(image, mosaic=image.rgb.gather(1, channel), pattern=BAYER)


def moved(image, dx, dy):
    changes = {"rgb": image.rgb.roll((dy, dx), (-2, -1))}
    if image.mosaic is not None:
        changes["mosaic"] = image.mosaic.roll((dy, dx), (-2, -1))
    return replace(image, **changes)


def with_bar(light):
    """A broad bright streak over a sixth of the picture."""
    light = light.clone()
    light[:, 100:140] = torch.tensor([0.9, 0.8, 0.1])[:, None, None]
    return light


@pytest.mark.parametrize("dress", [lambda image: image, with_mosaic], ids=["rgb", "mosaic"])
def test_a_moved_camera_is_named_with_its_shift(dress):
    shot, ground = dress(picture(with_bar(SCENE))), dress(picture(SCENE, 1))
    check_same_scene(shot, ground)
    for shift in ((6, 0), (-4, 6), (30, -20)):
        with pytest.raises(MismatchError, match="the camera moved") as refusal:
            check_same_scene(moved(shot, *shift), ground)
        named = re.search(r"by about \((-?\d+), (-?\d+)\) px", str(refusal.value))
        assert [int(px) for px in named.groups()] == pytest.approx(shift, abs=1)


def test_another_scene_is_named():
    other = textured_background(WIDTH, HEIGHT, contrast=0.15, seed=4)
    with pytest.raises(MismatchError, match="most of what stands out in the background"):
        check_same_scene(picture(with_bar(other)), picture(SCENE, 1))


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_flat_scene_tells_nothing(noise):
    wall = flat_background(WIDTH, HEIGHT)
    check_same_scene(picture(with_bar(wall), 0, noise), picture(wall, 1, noise))
    check_same_scene(picture(with_bar(wall), 0, noise), picture(1.02 * wall, 1, noise))


def test_uneven_light_is_no_other_scene():
    shade = torch.linspace(0.6, 1.2, WIDTH)
    check_same_scene(picture(with_bar(SCENE * shade)), picture(SCENE, 1))


def test_noise_alone_is_no_other_scene():
    faint = textured_background(WIDTH, HEIGHT, contrast=0.01, seed=3)
    check_same_scene(picture(faint, 0, 0.02), picture(faint, 1, 0.02))


@pytest.mark.parametrize("light", [(9.0, 1.0, 1.0), (1.0, 0.1, 1.0), (1.0, 1.0, float("inf"))])
def test_light_that_cannot_be_compared_is_named(light):
    with pytest.raises(MismatchError, match=f"{light[0]:g}, {light[1]:g}, {light[2]:g} times"):
        check_light(torch.tensor(light))
    check_light(torch.tensor([0.5, 1.0, 2.0]))


@pytest.mark.shared_data
@pytest.mark.skipif(not STREAKS.is_dir(), reason="the real streaks are not beside the project")
def test_a_real_scene_is_recognised():
    shot = read_image(STREAKS / "floorball1.png", response="srgb")
    ground = read_background([STREAKS / "floorball_bgr.png"], response="srgb")
    check_same_scene(shot, ground)
    with pytest.raises(MismatchError, match=r"about \(5, 0\) px"):
        check_same_scene(moved(shot, 5, 0), ground)
    with pytest.raises(MismatchError, match="most of what stands out"):
        check_same_scene(shot, replace(ground, rgb=ground.rgb.flip(-1)))
