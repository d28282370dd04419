import pytest
import torch

from toolkit import LinearImage
from toolkit.block_means import block_means, whole_periods


def behind_mosaic(image):
    pattern = ((0, 1), (1, 2))
    channel = torch.tensor(pattern).repeat(image.height // 2 + 1, image.width // 2 + 1)
    mosaic = image.rgb.gather(1, channel[None, None, : image.height, : image.width])
    return LinearImage(mosaic=mosaic, clipped=image.clipped, pattern=pattern)


@pytest.mark.parametrize("factor", [2, 4])
@pytest.mark.parametrize("behind", [behind_mosaic, lambda image: image])
def test_a_reduced_picture_averages_blocks_and_marks_those_that_met_white(factor, behind):
    rgb = torch.full((1, 3, 21, 30), 0.25)
    rgb[..., 8:12, 4:8] = 0.75
    clipped = torch.zeros(1, 1, 21, 30, dtype=torch.bool)
    clipped[..., [3, 13], [7, 20]] = True
    reduced = block_means(behind(LinearImage(rgb=rgb, clipped=clipped)), factor)
    height, width = 21 // factor, 30 // factor
    blocks = clipped[..., : height * factor, : width * factor]
    blocks = blocks.reshape(1, 1, height, factor, width, factor)
    assert torch.equal(reduced.clipped, blocks.any(-1).any(-2))
    expected = torch.full((1, 3, height, width), 0.25)
    expected[..., 8 // factor : 12 // factor, 4 // factor : 8 // factor] = 0.75
    assert torch.allclose(reduced.rgb, expected)
    assert reduced.mosaic is None


def test_a_mosaic_is_reduced_by_whole_periods():
    image = LinearImage(
        rgb=torch.zeros(1, 3, 8, 8), clipped=torch.zeros(1, 1, 8, 8, dtype=torch.bool)
    )
    assert whole_periods(image, 3) == 3
    assert whole_periods(behind_mosaic(image), 3) == 4
    assert whole_periods(behind_mosaic(image), 4) == 4


@pytest.mark.parametrize("factor", [2, 3, 4])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_each_mean_is_that_of_its_block_and_as_precise_as_the_picture(factor, dtype):
    rgb = torch.rand(1, 3, 21, 30, dtype=dtype, generator=torch.Generator().manual_seed(1))
    image = LinearImage(rgb=rgb, clipped=torch.zeros(1, 1, 21, 30, dtype=torch.bool))
    reduced = block_means(image, factor).rgb
    assert reduced.dtype == dtype
    assert torch.allclose(reduced, torch.nn.functional.avg_pool2d(rgb, factor), atol=1e-6)
