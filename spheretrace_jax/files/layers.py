"""`Layer`: the channels of a picture file that hold one picture.

A file may have several parts: views, layers, pages, frames. EXR files also name channels by layer,
as in `beauty.R`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..base.errors import PictureError, printable

_COLORS = {"r": 0, "red": 0, "g": 1, "green": 1, "b": 2, "blue": 2}
_GREY, _ALPHA = ("y", "l", "grey", "gray", "luminance"), ("a", "alpha")

# The layers that hold the whole picture, in programs that write many.
_WHOLE = ("", "rgb", "rgba", "beauty", "combined", "composite", "c")

_MOST_PARTS = 1000  # looked at
_MOST_NAMES = 12  # in a message

# The differences of colours of files that store brightness and colour apart.
_CHROMA = {"RY", "BY"}

# The kinds of parts of a TIFF file that are no pictures of their own: small copies and masks.
_COPY = 1 | 4


@dataclass(frozen=True)
class Layer:
    """The channels of a picture, in one part of a file."""

    part: int  #: its number from 0
    name: str  #: as `layer` says it; empty for the only part's channels without a name
    full_name: str  #: with the name of the part
    color: tuple[int, ...]  #: the channels: of red, green and blue, or one of grey
    alpha: int | None


def choose_layer(path: Path, source: Any, wanted: str | None) -> tuple[Layer, str]:
    """Chooses the layer that holds the picture.

    **Arguments:** `source`: OpenImageIO's open file. `wanted`: the name of a layer, if not the one
    that is taken to be the whole picture.

    **Returns:** the layer; and if others could be meant, a sentence that names them.

    **Raises:** `PictureError` for names that no layer has, and files without a layer of colours.
    """
    layers, channels, copies = _layers(source)
    if not layers:
        found = ", ".join(channels[:_MOST_NAMES]) or "none"
        what = "only a small copy of the picture, as raw files of cameras have it" if copies else (
            f"the channels {found}"
        )  # fmt: skip
        raise PictureError(
            f"{path}: expected a picture of red, green and blue, or grey, got {what}"
        )
    names = _listed([layer.name for layer in layers])
    if wanted is not None:
        names_of = lambda layer: (layer.name, layer.full_name, str(layer.part + 1))
        named = [layer for layer in layers if wanted in names_of(layer)]
        if not named:
            known = f"only {names}" if any(layer.name for layer in layers) else "as it names none"
            raise PictureError(f"{path}: there is no layer {wanted!r}, {known}")
        return named[0], ""
    whole = lambda layer: layer.name.rpartition(".")[2].lower() not in _WHOLE
    chosen = min(layers, key=whole)
    if len(layers) == 1:
        return chosen, ""
    return chosen, f"of the layers {names} read {chosen.name!r}: layer= (fit --layer) names another"


def _layers(source: Any) -> tuple[list[Layer], list[str], bool]:
    """Lists the layers, the names of all channels, and whether there are small copies."""
    found, channels, copies = [], [], False
    for part in range(_MOST_PARTS):
        if not source.seek_subimage(part, 0):
            break
        spec = source.spec()
        if int(spec.getattribute("tiff:subfiletype") or 0) & _COPY:
            copies = True
            continue
        channels += map(printable, spec.channelnames)
        title = spec.getattribute("oiio:subimagename") or spec.getattribute("view") or part + 1
        for name, color, alpha in _layers_of_part(spec, source.format_name()):
            found.append((part, printable(str(title)), printable(name), color, alpha))
    several = len({part for part, *_ in found}) > 1  # else the part needs no name
    names = [name or (title if several else "") for _, title, name, *_ in found]
    layers = []
    for (part, title, name, color, alpha), short in zip(found, names, strict=True):
        full = ".".join(filter(None, (title if several else "", name)))
        unique = names.count(short) == 1
        layers.append(Layer(part, short if unique else full, full, color, alpha))
    return layers, channels, copies


def _layers_of_part(spec: Any, format_name: str) -> list[tuple[str, tuple[int, ...], int | None]]:
    """Lists the layers of a part: name, channels of the colours, channel of alpha."""
    colors: dict[str, dict[int, int]] = {}
    greys: dict[str, int] = {}
    alphas: dict[str, int] = {}
    vectors = {full_name[:-2] for full_name in spec.channelnames if full_name[-2:] in (".X", ".Z")}
    for channel, full_name in enumerate(spec.channelnames):
        layer, _, name = full_name.rpartition(".")
        name = name.lower()
        if name in _COLORS:
            colors.setdefault(layer, {}).setdefault(_COLORS[name], channel)
        elif name in _GREY and layer not in vectors:  # the Y of a normal is no brightness
            greys.setdefault(layer, channel)
        elif name in _ALPHA:
            alphas.setdefault(layer, channel)
    found: dict[str, tuple[int, ...]] = {layer: (channel,) for layer, channel in greys.items()}
    found |= {layer: (of[0], of[1], of[2]) for layer, of in colors.items() if len(of) == len("RGB")}
    if format_name == "openexr":
        if _CHROMA & set(spec.channelnames):
            return []
        alpha_of = lambda layer: alphas.get(layer, alphas.get(""))
        return [(layer, channels, alpha_of(layer)) for layer, channels in found.items()]
    # other formats do not name what their channels are
    count = spec.nchannels
    alpha = spec.alpha_channel if 0 <= spec.alpha_channel < count else None
    return [("", found.get("") or ((0,) if count < len("RGB") else (0, 1, 2)), alpha)]


def _listed(names: list[str]) -> str:
    """Lists names, of many only the first ones."""
    listed = ", ".join(map(repr, names[:_MOST_NAMES]))
    more = len(names) - _MOST_NAMES
    return f"{listed} and {more} more" if more > 0 else listed
