"""Picture formats: for each ending, how OpenImageIO writes the file. A new format is an entry."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class PictureFormat:
    """A format of picture files that OpenImageIO writes."""

    bits: tuple[int, ...]  #: possible bits per number, the default first; 32 are floating
    tagged: bool = True  #: the file can say how its numbers are coded
    profile: bool = False  #: it says so of linear numbers by an ICC profile
    half: bool = False  #: 16 bits are floating
    long_text: bool = False  #: metadata may hold a text of any length
    attributes: Mapping[str, str | int] = field(default_factory=dict)  #: OpenImageIO's, for writing

    def number_type(self, bits: int) -> str:
        """Returns OpenImageIO's name of the type of numbers with so many bits."""
        if bits == 32:
            return "float"
        return "half" if self.half else f"uint{bits}"


_TIFF = PictureFormat((8, 16, 32), profile=True)
_JPEG = PictureFormat(
    (8,), profile=True, attributes={"compression": "jpeg:95", "jpeg:subsampling": "4:4:4"}
)

#: The formats that are written, by ending.
PICTURE_FORMATS = {
    ".exr": PictureFormat((32, 16), half=True, long_text=True, attributes={"compression": "zip"}),
    ".hdr": PictureFormat((32,), tagged=False),
    ".png": PictureFormat((8, 16), long_text=True),
    # OpenImageIO 3.2 would write integer PPM upside down without this attribute
    ".ppm": PictureFormat((8, 16), tagged=False, attributes={"pnm:pfmflip": 0}),
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".jpg": _JPEG,
    ".jpeg": _JPEG,
}
