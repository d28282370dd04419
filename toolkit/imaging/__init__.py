"""Pictures from files and to files: the only place with paths and decoders."""

from toolkit.demosaicing import DEMOSAICERS, demosaic
from toolkit.imaging.backgrounds import read_background
from toolkit.imaging.dng import write_dng
from toolkit.imaging.metadata import exposure_time
from toolkit.imaging.png import write_png16
from toolkit.imaging.reading import read_image

__all__ = [
    "DEMOSAICERS",
    "demosaic",
    "exposure_time",
    "read_background",
    "read_image",
    "write_dng",
    "write_png16",
]
