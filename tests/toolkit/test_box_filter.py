import pytest
import torch
from kornia.filters import box_blur

from toolkit.box_filter import box_mean


@pytest.mark.filterwarnings("ignore:`torch.jit.script`:DeprecationWarning")
@pytest.mark.parametrize("size", [1, 3, 7])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_agrees_with_kornia(size, dtype):
    picture = torch.rand(2, 3, 13, 17, dtype=dtype, generator=torch.Generator().manual_seed(1))
    expected = box_blur(picture, (size, size), border_type="replicate")
    torch.testing.assert_close(box_mean(picture, size), expected, atol=1e-6, rtol=0)


def test_the_picture_is_left_as_it_was():
    picture = torch.rand(1, 1, 5, 6)
    before = picture.clone()
    assert box_mean(picture, 3).shape == picture.shape
    assert torch.equal(picture, before)
