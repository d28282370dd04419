import pytest
import torch

from toolkit.errors import ShapeError
from toolkit.shapes import check_shape


def test_letters_stand_for_any_length():
    check_shape("points", torch.zeros(4, 7, 2), "B", "N", 2)
    check_shape("points", torch.zeros(0, 1, 2), "B", "N", 2)
    check_shape("number", torch.zeros(()))


@pytest.mark.parametrize(
    ("shape", "wanted"),
    [
        ((4, 7, 3), ("B", "N", 2)),
        ((4, 2), ("B", "N", 2)),
        ((4, 7, 2, 1), ("B", "N", 2)),
        ((1,), ()),
    ],
)
def test_other_shapes_are_refused_with_both_named(shape, wanted):
    with pytest.raises(ShapeError, match="points has shape") as caught:
        check_shape("points", torch.zeros(shape), *wanted)
    assert str(list(shape)) in str(caught.value)
    assert ", ".join(str(w) for w in wanted) in str(caught.value)


def test_one_letter_stands_for_one_length():
    check_shape("square", torch.zeros(3, 3), "N", "N")
    with pytest.raises(ShapeError, match="square"):
        check_shape("square", torch.zeros(3, 4), "N", "N")
