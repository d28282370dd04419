"""Shape checks for the public border; inside, shapes are trusted."""

from torch import Tensor

from toolkit.errors import ShapeError


def check_shape(name: str, tensor: Tensor, *shape: int | str) -> None:
    """Raise `ShapeError` unless `tensor` has the given shape.

    Args:
        name: what the caller calls the tensor, for the message.
        tensor: the tensor to look at.
        shape: one entry per axis; an integer is a required length, a letter stands for any length
            but the same letter for the same length.

    Raises:
        ShapeError: when the number of axes or a length disagrees.

    Example:
        >>> import torch
        >>> check_shape("points", torch.zeros(4, 7, 2), "B", "N", 2)
    """
    lengths: dict[str, int] = {}
    agrees = tensor.ndim == len(shape)
    for length, wanted in zip(tensor.shape, shape, strict=False):
        expected = lengths.setdefault(wanted, length) if isinstance(wanted, str) else wanted
        agrees = agrees and length == expected
    if not agrees:
        wanted_text = ", ".join(str(w) for w in shape)
        raise ShapeError(f"{name} has shape {list(tensor.shape)}, but [{wanted_text}] is needed")
