"""Picture files as cameras and other programs write them."""

import struct
import zlib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio


def decode(coded: np.ndarray | float) -> np.ndarray:
    """Decodes sRGB to linear numbers, by IEC 61966-2-1."""
    coded = np.asarray(coded, np.float64)
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def _spec(numbers: np.ndarray, names: tuple[str, ...], alpha: int, attributes: dict):
    height, width, channels = numbers.shape
    kind = {"float32": "float", "float16": "half"}.get(str(numbers.dtype), str(numbers.dtype))
    spec = oiio.ImageSpec(width, height, channels, kind)
    if names:
        spec.channelnames = names
    spec.alpha_channel = alpha
    for name, value in attributes.items():
        name = name.replace("__", ":")
        if isinstance(value, bytes):
            kind = oiio.TypeDesc(f"uint8[{len(value)}]")
            spec.attribute(name, kind, np.frombuffer(value, np.uint8))
        elif isinstance(value, tuple):
            spec.attribute(name, f"float[{len(value)}]", value)
        else:
            spec.attribute(name, value)
    return spec


def write_raw(
    file: Path,
    numbers: np.ndarray,
    alpha: int = -1,
    *,
    names: tuple[str, ...] = (),
    window: tuple[int, int, int, int] | None = None,
    **attributes,
) -> None:
    """Writes a file with exactly these numbers, by OpenImageIO alone.

    **Arguments:** `names`: of the channels. `window`: where the numbers begin in the display
    window (x, y), and its width and height. `attributes`: OpenImageIO's, with __ for a colon.
    """
    spec = _spec(numbers, names, alpha, attributes)
    if window is not None:
        spec.x, spec.y, spec.full_width, spec.full_height = window
    sink = oiio.ImageOutput.create(str(file))
    assert sink.open(str(file), spec) and sink.write_image(numbers) and sink.close()


def write_parts(file: Path, *parts: tuple[np.ndarray, dict]) -> None:
    """Writes a file of several parts: numbers and OpenImageIO's attributes; `names` of channels."""
    specs = [_spec(n, a.pop("names", ()), a.pop("alpha", -1), a) for n, a in parts]
    sink = oiio.ImageOutput.create(str(file))
    at_once = sink.format_name() == "openexr"
    assert sink.open(str(file), tuple(specs)) if at_once else sink.open(str(file), specs[0])
    for k, (numbers, _) in enumerate(parts):
        assert not k or sink.open(str(file), specs[k], "AppendSubimage")
        assert sink.write_image(numbers)
    assert sink.close()


def write_deep(file: Path) -> None:
    """Writes a deep EXR picture of 2 x 2 pixels with two samples each."""
    names = ("R", "G", "B", "A", "Z")
    spec = oiio.ImageSpec(2, 2, len(names), "float")
    spec.deep, spec.channelnames, spec.alpha_channel, spec.z_channel = True, names, 3, 4
    data = oiio.DeepData()
    data.init(4, len(names), [oiio.FLOAT] * len(names), names)
    for pixel in range(4):
        data.set_samples(pixel, 2)
        for sample in range(2):
            for channel, value in enumerate((0.1, 0.2, 0.3, 0.5, 1.0 + sample)):
                data.set_deep_value(pixel, channel, sample, value)
    sink = oiio.ImageOutput.create(str(file))
    assert sink.open(str(file), spec) and sink.write_deep_image(data) and sink.close()


def chunk(name: bytes, body: bytes) -> bytes:
    """Builds a chunk of a PNG file."""
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def png(
    width: int, height: int, rows: bytes = b"", before: bytes = b"", depth: int = 8, color: int = 2,
    interlaced: int = 0,
) -> bytes:  # fmt: skip
    """Builds a PNG file, with any size in its header.

    **Arguments:** `rows`: with the number of its filter before each. `before`: other chunks.
    """
    header = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, interlaced)
    pixels = chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + before + pixels


def flat_png(value: int, before: bytes = b"", depth: int = 8) -> bytes:
    """Builds a grey PNG file in colour, of 3 x 2 pixels."""
    row = b"\0" + value.to_bytes(depth // 8, "big") * 9
    return png(3, 2, row * 2, before, depth)


#: X, Y, Z under D50 of red, green and blue, as in the published profiles.
SRGB_D50 = ((0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.71410))
P3_D50 = ((0.51512, 0.24120, -0.00105), (0.29198, 0.69225, 0.04189), (0.15710, 0.06657, 0.78407))
ADOBE_D50 = ((0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457))
PROPHOTO_D50 = ((0.79767, 0.28804, 0.0), (0.13519, 0.71188, 0.0), (0.03134, 0.00009, 0.82491))


def fixed(*numbers: float) -> bytes:
    """Returns numbers of 16 bits and 16 bits of fraction, as profiles have them."""
    return np.round(np.array(numbers) * 65536).astype(">i4").tobytes()


def gamma_curve(gamma: float) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(">IH", 1, round(gamma * 256)) + b"\0\0"


def table_curve(values: np.ndarray) -> bytes:
    numbers = np.round(np.asarray(values) * 65535).astype(">u2").tobytes()
    return b"curv\0\0\0\0" + struct.pack(">I", len(values)) + numbers


def parametric_curve(form: int, *numbers: float) -> bytes:
    return b"para\0\0\0\0" + struct.pack(">HH", form, 0) + fixed(*numbers)


#: sRGB's curve in a profile.
SRGB_CURVE = parametric_curve(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


def icc_profile(
    columns: tuple = SRGB_D50, curve: bytes = SRGB_CURVE, name: str = "test", *,
    space: bytes = b"RGB ", tags: dict[bytes, bytes] | None = None,
) -> bytes:  # fmt: skip
    """Builds an ICC profile. **Arguments:** `tags`: in place of those of curves and a matrix."""
    text = name.encode("utf-16-be")
    shown = b"mluc" + struct.pack(">IIIHHII", 0, 1, 12, 0x656E, 0x5553, len(text), 28) + text
    if tags is None:
        tags = {}
        for name_of, xyz in zip((b"r", b"g", b"b"), columns, strict=True):
            tags[name_of + b"XYZ"] = b"XYZ \0\0\0\0" + fixed(*xyz)
            tags[name_of + b"TRC"] = curve
    tags = {b"desc": shown, b"wtpt": b"XYZ \0\0\0\0" + fixed(0.9642, 1, 0.8249)} | tags
    table, body = struct.pack(">I", len(tags)), b""
    for tag, content in tags.items():
        table += struct.pack(">4sII", tag, 132 + 12 * len(tags) + len(body), len(content))
        body += content.ljust(-(-len(content) // 4) * 4, b"\0")
    size = 128 + len(table) + len(body)
    head = struct.pack(">IIH2x4s4s", size, 0, 0x0210, b"mntr", space)
    head += b"XYZ " + bytes(12) + b"acsp" + bytes(28) + fixed(0.9642, 1, 0.8249)
    return head.ljust(128, b"\0") + table + body
