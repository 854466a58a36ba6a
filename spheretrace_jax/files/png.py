"""PNG files chunk by chunk: what OpenImageIO does not tell of them, and whether they are whole.

libpng prints to the process's standard error where a file is damaged, and no thread can silence it
for itself. So damage is found before libpng sees the file. The format: W3C, Portable Network
Graphics (PNG) Specification (Third Edition).
"""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base.errors import PictureError

SIGNATURE = b"\x89PNG\r\n\x1a\n"

_CRITICAL = (b"IHDR", b"PLTE", b"IDAT", b"IEND")
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by type of colour
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_LONGEST_SIDE = 1_000_000  # libpng's limit
_PALETTE = 3

# The passes of an interlaced picture: first column and row, and the steps to the next.
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2),
          (0, 1, 1, 2))  # fmt: skip


@dataclass(frozen=True)
class PngFile:
    """The chunks of a PNG file."""

    path: Path
    width: int
    height: int
    bits: int  #: of a pixel
    interlaced: bool
    compressed: bytes  #: the pixels
    ancillary: dict[bytes, bytes]  #: the first chunk of each other name

    @property
    def frames(self) -> int:
        """Returns how many pictures an animation has; 1 for a picture."""
        control = self.ancillary.get(b"acTL", b"")
        return struct.unpack(">I", control[:4])[0] if len(control) == 8 else 1

    @property
    def chromaticities(self) -> tuple[float, ...] | None:
        """Returns x and y of red, green, blue and white, if only they tell the colours."""
        numbers = self.ancillary.get(b"cHRM", b"")
        stronger = any(name in self.ancillary for name in (b"cICP", b"iCCP", b"sRGB"))
        if stronger or len(numbers) != 32:
            return None
        white, *primaries = np.reshape(struct.unpack(">8I", numbers), (4, 2)) / 1e5
        return tuple(float(x) for pair in (*primaries, white) for x in pair)

    def check_pixels(self) -> None:
        """Checks that the pixels are all there. **Raises:** `PictureError`."""
        steps = _ADAM7 if self.interlaced else ((0, 0, 1, 1),)
        passes = [
            (1 + (-(-(self.width - x) // dx) * self.bits + 7) // 8, -(-(self.height - y) // dy))
            for x, y, dx, dy in steps
            if self.width > x and self.height > y
        ]
        size = sum(stride * rows for stride, rows in passes)
        try:
            numbers = zlib.decompressobj().decompress(self.compressed, size)
        except zlib.error:
            raise _fault(self.path, "its compressed pixels are damaged") from None
        if len(numbers) < size:
            raise _fault(self.path, "its pixels are not all there")
        start = 0
        for stride, rows in passes:  # each row starts with the number of its filter
            if max(numbers[start : start + stride * rows : stride]) > 4:
                raise _fault(self.path, "its compressed pixels are damaged")
            start += stride * rows


def read_png(path: Path) -> PngFile:
    """Reads the chunks of a PNG file. **Raises:** `PictureError` for damaged files; `OSError`."""
    data = path.read_bytes()
    chunks: dict[bytes, bytes] = {}
    pixels: list[bytes] = []
    offset = len(SIGNATURE)
    while offset < len(data) and b"IEND" not in chunks:
        length, name = struct.unpack(">I4s", data[offset : offset + 8].ljust(8, b"\0"))
        body, end = data[offset + 8 : offset + 8 + length], offset + 12 + length
        if end > len(data):
            raise _fault(path, "the file ends within a chunk")
        if not name.isalpha() or (name[:1].isupper() and name not in _CRITICAL):
            raise _fault(path, "a chunk is of no known kind")
        sound = zlib.crc32(name + body) == int.from_bytes(data[end - 4 : end], "big")
        if name in _CRITICAL and not sound:
            raise _fault(path, f"its {name.decode()} chunk is damaged")
        if offset == len(SIGNATURE) and name != b"IHDR":
            raise _fault(path, "it has no header")
        if name == b"IDAT":
            pixels.append(body)
        elif sound:
            chunks.setdefault(name, body)
        offset = end
    header = chunks.get(b"IHDR", b"")
    if len(header) != 13 or not pixels:
        raise _fault(path, "it holds no pixels")
    width, height, depth, color, compression, filters, interlace = struct.unpack(">IIBBBBB", header)
    if (
        not (0 < width <= _LONGEST_SIDE and 0 < height <= _LONGEST_SIDE)
        or depth not in _DEPTHS.get(color, ())
        or (compression, filters) != (0, 0)
        or interlace > 1
    ):
        raise _fault(path, "its header makes no sense")
    colors = chunks.get(b"PLTE", b"")
    if color == _PALETTE and (not colors or len(colors) % 3 or len(colors) > 3 << depth):
        raise _fault(path, "its palette makes no sense")
    bits = depth * _CHANNELS[color]
    return PngFile(path, width, height, bits, interlace == 1, b"".join(pixels), chunks)


def _fault(path: Path, reason: str) -> PictureError:
    return PictureError(f"{path}: cannot be read as a picture: {reason}")
