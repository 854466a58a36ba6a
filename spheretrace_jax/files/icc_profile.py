"""ICC profiles: which colours the numbers of a picture mean.

Only profiles of curves and a matrix are read, as cameras, phones and screens have them: tables for
printers are refused. (OpenColorIO reads these too, but clips numbers at 1, reads no grey profiles,
and prints warnings.) The format: ICC.1:2022, Image technology colour management.
"""

import struct

import numpy as np

from .color_spaces import (
    D50,
    D65,
    PRIMARIES,
    Curve,
    Matrix,
    adaptation,
    power,
    to_xyz,
    xyz_to_rec709,
)

# How many numbers a parametric curve has, by its type.
_PARAMETERS = (1, 3, 4, 5, 7)

# The error of white below which it is one of rounding.
_ROUNDING = 0.01

# The codes of curves of high dynamic range in a `cicp` tag (ITU-T H.273): PQ and HLG.
_HIGH_DYNAMIC_RANGE = (16, 18)


def read_profile(
    profile: bytes,
) -> tuple[tuple[Curve, ...], Matrix | None]:
    """Reads the curves to linear light of red, green and blue, and the matrix to linear Rec. 709.

    **Returns:** the curves, and the matrix; no matrix for a grey profile.

    **Raises:** `ValueError` that says why it cannot be used, as a predicate.
    """
    tags = _tags(profile)
    space, connection = profile[16:20], profile[20:24]
    if tags.get(b"cicp", b"")[9:10] and tags[b"cicp"][9] in _HIGH_DYNAMIC_RANGE:
        raise ValueError("is of high dynamic range (PQ or HLG)")
    if space == b"GRAY" and b"kTRC" in tags:
        curve = _curve(tags[b"kTRC"])
        return (curve, curve, curve), None
    names = [(c + b"TRC", c + b"XYZ") for c in (b"r", b"g", b"b")]
    if (
        space != b"RGB "
        or connection != b"XYZ "
        or any(n not in tags for pair in names for n in pair)
    ):
        kind = space.decode("ascii", "replace").strip()
        raise ValueError(f"is one of tables for {kind} colours, not of curves and a matrix")
    red, green, blue = (_curve(tags[curve]) for curve, _ in names)
    to_d50 = np.stack([_fixed(tags[xyz][8:20]) for _, xyz in names], axis=1)
    if to_d50.shape != (3, 3) or abs(np.linalg.det(to_d50)) < 1e-6:
        raise ValueError("has colours that make no sense")
    matrix = xyz_to_rec709(D50) @ to_d50
    white = matrix.sum(axis=1, keepdims=True)
    if np.abs(white - 1).max() < _ROUNDING:  # so that white is 1, by which clipped numbers show
        matrix = matrix / white
    return (red, green, blue), matrix


def _tags(profile: bytes) -> dict[bytes, bytes]:
    """Returns the tags of a profile. **Raises:** `ValueError` for no or damaged profiles."""
    if len(profile) < 132 or profile[36:40] != b"acsp":
        raise ValueError("is damaged")
    (count,) = struct.unpack(">I", profile[128:132])
    entries = [profile[k : k + 12] for k in range(132, 132 + 12 * min(count, 100), 12)]
    found = {}
    for entry in entries:
        if len(entry) < 12:
            raise ValueError("is damaged")
        name, start, size = struct.unpack(">4sII", entry)
        found[name] = profile[start : start + size]
    return found


def _fixed(data: bytes) -> np.ndarray:
    """Reads signed numbers of 16 bits and 16 bits of fraction."""
    return np.frombuffer(data[: len(data) // 4 * 4], ">i4").astype(np.float64) / 65536


def _curve(tag: bytes) -> Curve:
    """Returns the curve of a tag. **Raises:** `ValueError` for other kinds."""
    kind = tag[:4]
    if kind == b"curv" and len(tag) >= 12:
        (count,) = struct.unpack(">I", tag[8:12])
        numbers = np.frombuffer(tag[12 : 12 + 2 * count], ">u2").astype(np.float64)
        if len(numbers) == count:
            if count == 0:
                return lambda x: x
            if count == 1:
                return power(float(numbers[0]) / 256)
            at = np.linspace(0, 1, count)
            return lambda x: np.interp(x, at, numbers / 65535)
    if kind == b"para" and len(tag) >= 12:
        (form,) = struct.unpack(">H", tag[8:10])
        numbers = _fixed(tag[12:])
        if form < len(_PARAMETERS) and len(numbers) >= _PARAMETERS[form]:
            return _parametric(form, numbers[: _PARAMETERS[form]].tolist())
    raise ValueError("has a curve that makes no sense")


def _parametric(form: int, numbers: list[float]) -> Curve:
    """Returns (a x + b)^g + e from a limit on, and c x + f below it."""
    g, a, b, c, d, e, f = numbers + [0.0] * (_PARAMETERS[-1] - len(numbers))
    if form == 0:
        return power(g)
    if a == 0:
        raise ValueError("has a curve that makes no sense")
    if form in (1, 2):  # the fourth number is added to both branches
        c, d, e, f = 0.0, -b / a, c, c
    above = lambda x: np.maximum(a * x + b, 0) ** g + e
    return lambda x: np.where(x >= d, above(x), c * x + f)


def linear_profile() -> bytes:
    """Returns a profile of linear Rec. 709, for files that cannot say so otherwise."""
    text = lambda words: (
        b"mluc"
        + struct.pack(">IIIHHII", 0, 1, 12, 0x656E, 0x5553, 2 * len(words), 28)
        + words.encode("utf-16-be")
    )
    xyz = lambda numbers: b"XYZ " + bytes(4) + _to_fixed(numbers)
    to_d50 = adaptation(D65, D50)
    columns = (to_d50 @ to_xyz(PRIMARIES["rec709"])).T
    tags = {
        b"desc": text("Linear Rec. 709"),
        b"cprt": text("CC0"),
        b"wtpt": xyz(D50),
        b"chad": b"sf32" + bytes(4) + _to_fixed(to_d50),
        **{c + b"XYZ": xyz(column) for c, column in zip((b"r", b"g", b"b"), columns, strict=True)},
        **{c + b"TRC": b"curv" + bytes(8) for c in (b"r", b"g", b"b")},
    }
    table, body = struct.pack(">I", len(tags)), b""
    for name, tag in tags.items():
        table += struct.pack(">4sII", name, 132 + 12 * len(tags) + len(body), len(tag))
        body += tag.ljust(-(-len(tag) // 4) * 4, b"\0")
    size = 128 + len(table) + len(body)
    header = struct.pack(">I4sI4s4s4s12s4s", size, b"", 0x04300000, b"mntr", b"RGB ", b"XYZ ",
                         struct.pack(">6H", 2026, 1, 1, 0, 0, 0), b"acsp")  # fmt: skip
    return header.ljust(68, b"\0") + _to_fixed(D50).ljust(60, b"\0") + table + body


def _to_fixed(numbers: np.ndarray) -> bytes:
    return np.round(np.ravel(numbers) * 65536).astype(">i4").tobytes()
