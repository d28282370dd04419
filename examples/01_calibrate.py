"""Photos of a checkerboard in, a camera out.

Run:  python examples/01_calibrate.py demo/boards/*.dng
"""

import sys
import tempfile
from pathlib import Path

from toolkit import read_camera
from toolkit.cli.main import main


def calibrate(photos: list[str]) -> None:
    """Calibrate as `toolkit calibrate --images ...` does, then use the camera."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "camera.toml"
        code = main(["calibrate", "--images", *photos, "--out", str(path)])
        if code:
            sys.exit(code)
        camera = read_camera(path)
    print(f"focal length {camera.fx:.1f} x {camera.fy:.1f} px")
    if camera.covariance is not None:
        std = camera.covariance.diagonal().sqrt()
        print(f"          +/- {std[0]:.1f} x {std[1]:.1f} px")


if __name__ == "__main__":
    calibrate(sys.argv[1:])
