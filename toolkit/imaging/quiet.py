"""Keep C libraries from printing on the terminal; their complaints come back as exceptions."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

_LOCK = Lock()
_STDERR = 2


@contextmanager
def quiet_decoders() -> Iterator[None]:
    """Send file descriptor 2 nowhere within the block.

    libraw, libpng, libtiff and tifffile's logger write there. It is the process's own descriptor,
    so that only one thread at a time may be inside.
    """
    with _LOCK:
        try:
            kept = os.dup(_STDERR)
        except OSError:  # closed, as in a windowed program: nothing to hide
            yield
            return
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, _STDERR)
            yield
        finally:
            os.dup2(kept, _STDERR)
            os.close(kept)
            os.close(nowhere)
