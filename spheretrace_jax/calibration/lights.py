"""`lights`: where the lights of photographs of a ball are, and how well the photographs tell."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import ArrayLike, Float, Num, Shaped

from ..base.errors import InputError, PictureWarning
from ..base.progress import working
from ..fit.model.picture_numbers import linear_numbers, yes_or_no
from ..scene.scene import Scene
from .ball_light import BallLight, light_of_fit, light_of_spot
from .ball_photo import BallPhoto, Exclusion, ball_photo
from .ball_scene import ball_scene
from .camera import Intrinsics, Number, intrinsics_of
from .conic import BallOutline, Ellipse, outline_of_ellipse
from .highlights import chrome_spots
from .light_fit import FoundLight, find_again, find_light, median_material
from .numbers_check import better_numbers
from .outline import ball_from_mask, coverage_of
from .photo_outline import ball_from_photo

Picture = Float[np.ndarray, "height width 3"]

# How far off an outline may be that is given as three numbers, in pixels.
_BY_HAND = 0.25

# How much larger the cost of a photograph may be by the material of all photographs: by more, it is
# not the same ball, or not in the same state.
_SAME_MATERIAL = 1.3

#: How the ball is given: "auto", a mask, (x, y, radius) in pixels, or an outline.
GivenBall = Any


class BallLights(Sequence[BallLight]):
    """The lights of photographs of a ball, in their order; of chrome balls several of each."""

    def __init__(
        self,
        lights: Sequence[BallLight],
        photos: Sequence[BallPhoto | None],
        albedo: Float[np.ndarray, "3"],
        radius: Number,
    ):
        """Takes lights, the photographs that they are of (None of mirrors), and the ball."""
        self._lights, self.photos = tuple(lights), tuple(photos)
        self.albedo, self.radius = albedo, radius

    def __getitem__(self, index: Any) -> Any:
        return self._lights[index]

    def __len__(self) -> int:
        return len(self._lights)

    def __iter__(self) -> Iterator[BallLight]:
        return iter(self._lights)

    def __str__(self) -> str:
        """Returns a line for each light."""
        return "\n".join(map(str, self))

    def _repr_html_(self) -> str:
        """Returns a table, for notebooks."""
        from ..display.notebook import lights_html

        return lights_html(self)

    @property
    def directions(self) -> Float[np.ndarray, "lights 3"]:
        """Returns all directions: unit vectors, x right, y up, z toward the viewer."""
        return np.array([light.direction for light in self]).reshape(-1, 3)

    def picture(self, number: int) -> Picture:
        """Returns what the fit of a photograph shows of the ball; nan elsewhere."""
        light, photo = self[number], self.photos[number]
        if photo is None or light.found is None:
            raise InputError(f"{light.name}: of a chrome ball there is no fit")
        return photo.shown(light.found.fit)

    def scene(self, number: int = 0) -> Scene:
        """Returns the scene of a photograph: camera, ball and light; a start for `fit`.

        World coordinates are the camera's: x right, y down, z forward, in the unit of the radius.
        """
        light, photo = self[number], self.photos[number]
        if photo is None:
            raise InputError(f"{light.name}: of a chrome ball no scene is made")
        return ball_scene(light, photo, self.albedo, self.radius)


def lights(
    pictures: Any,
    ball: GivenBall = "auto",
    *,
    focal: Number = np.inf,
    principal_point: tuple[Number, Number] | None = None,
    names: Sequence[str] | None = None,
    mask: Shaped[np.ndarray, "height width"] | None = None,
    brightest: Number | None = None,
    darkest: Number | None = None,
    albedo: ArrayLike | Sequence = (1.0, 1.0, 1.0),
    radius: Number = 1.0,
    chrome: bool = False,
    count: int | None = None,
    shared: bool = False,
) -> BallLights:
    """Finds the light of each photograph of a ball: direction, distance, colour and their errors.

    Each photograph has one light, and shows the ball by ambient light, diffuse light under a coat
    and a highlight (`ball_radiance.py`); the material is found, too. Of a chrome ball the spots are
    mirrored, one light each.

    **Arguments:**

    - `pictures`: one linear picture, or several: `(height, width, 3)` or grey, any scale.
    - `ball`: where the ball is: a mask, `(x, y, radius)` in pixels, a `BallOutline`, or a list of
      these, one for each picture. `"auto"` looks for it, in the mean of all pictures if they are of
      one size.
    - `focal`: the camera's focal length in pixels; inf for an orthographic camera. A wrong one
      turns lights, by up to the angle between the ball and the axis.
    - `principal_point`: `(x, y)` in pixels from the left and top edge, by default the middle.
    - `names`: of the photographs, for messages and files.
    - `mask`: which pixels count; `brightest`, `darkest`: numbers from here on are saturated, up to
      here too dark. By default saturation is told from the picture.
    - `albedo`: the ball's own diffuse colour, which `color` is divided by.
    - `radius`: of the ball, in the unit in which distances are wanted.
    - `chrome`: whether the ball is a mirror; `count`: how many lights it shows.
    - `shared`: whether all pictures show the ball with one material, the median of what each of
      them tells; pictures that it does not suit keep their own. It narrows the errors, to a half in
      12 pictures of one ball; the mean error was 0.15 degrees without and 0.18 with it.

    **Returns:** a `BallLight` for each.

    **Warns:** `PictureWarning` of grey and whole numbers.

    **Raises:** `InputError` for pictures that do not show the ball or no light on it.
    """
    several = isinstance(pictures, list | tuple) or np.ndim(pictures) == 4
    images = [_picture(np.asarray(p)) for p in (pictures if several else [pictures])]
    names = [f"photo {k + 1}" for k in range(len(images))] if names is None else list(names)
    if len(names) != len(images):
        raise InputError(f"names: expected {len(images)}, one for each picture, got {len(names)}")
    color = np.asarray(albedo, float)
    if color.shape != (3,) or not (color > 0).all():
        raise InputError(f"albedo: expected three numbers above 0, got {albedo}")
    if not radius > 0:
        raise InputError(f"radius: expected a length above 0, got {radius}")
    outlines = _outlines(images, ball, focal, principal_point, names)
    if chrome:
        found = []
        with working("finding lights", len(images)) as step:
            for name, image, outline in zip(names, images, outlines, strict=True):
                spots = _named(name, partial(chrome_spots, level=brightest), image, outline, count)
                found += [light_of_spot(name, spot, outline, radius) for spot in spots]
                step(name)
        return BallLights(found, [None] * len(found), color, radius)
    exclusion = Exclusion(None if mask is None else yes_or_no(np.asarray(mask)), brightest, darkest)
    photos = [ball_photo(*each, exclusion) for each in zip(names, images, outlines, strict=True)]
    alone, better, found = [], [], []
    with working("finding lights", len(photos)) as step:
        for name, photo in zip(names, photos, strict=True):
            alone.append(_named(name, find_light, photo))
            better.append(better_numbers(photo, alone[-1]))
            found.append(light_of_fit(name, photo, alone[-1], color, radius, better[-1]))
            step(name)
    if shared and len(photos) > 1:
        again = zip(names, photos, _shared(photos, alone), better, strict=True)
        found = [light_of_fit(n, p, one, color, radius, words) for n, p, one, words in again]
    return BallLights(found, photos, color, radius)


def _shared(photos: Sequence[BallPhoto], alone: Sequence[FoundLight]) -> list[FoundLight]:
    """Finds lights again, with the material that most photographs tell of."""
    material = median_material([one.fit for one in alone])
    found = []
    for photo, one in zip(photos, alone, strict=True):
        again = find_again(photo, one, material)
        same = again.fit.cost <= _SAME_MATERIAL * one.fit.cost
        found.append(again if same else one)
    return found


def _named(name: str, function: Callable, *args: Any) -> Any:
    """Calls a function. **Raises:** its `InputError` with the photograph's name in front."""
    try:
        return function(*args)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _picture(picture: Num[np.ndarray, "height width *channels"]) -> Picture:
    """Returns a picture of three channels with white at 1. **Raises:** `PictureError`."""
    numbers, word = linear_numbers(picture)
    if word is not None:
        warnings.warn(word.replace("the target", "the picture"), PictureWarning, stacklevel=3)
    return numbers.astype(float)


def _outlines(
    images: Sequence[Picture],
    ball: GivenBall,
    focal: Number,
    principal_point: tuple[Number, Number] | None,
    names: Sequence[str],
) -> list[BallOutline]:
    """Returns the outline of each picture's ball."""
    sizes = {image.shape[:2] for image in images}
    if isinstance(ball, list):
        if len(ball) != len(images):
            raise InputError(f"ball: expected {len(images)}, one for each picture, got {len(ball)}")
        given = zip(names, images, ball, strict=True)
        return [_outline(n, i, b, focal, principal_point) for n, i, b in given]
    if len(sizes) == 1:
        one = _outline("ball", _mean(images), ball, focal, principal_point)
        return [one] * len(images)
    return [
        _outline(n, i, ball, focal, principal_point) for n, i in zip(names, images, strict=True)
    ]


def _mean(images: Sequence[Picture]) -> Picture:
    """Returns the mean picture, each as bright: in it every part of the outline is lit."""
    total = np.zeros_like(images[0])
    for image in map(np.nan_to_num, images):
        total += np.clip(image / max(np.quantile(image, 0.999), 1e-300), 0, 1)
    return total / len(images)


def _outline(
    name: str,
    image: Picture,
    ball: GivenBall,
    focal: Number,
    principal_point: tuple[Number, Number] | None,
) -> BallOutline:
    """Returns the outline of a ball that is given in one way or another."""
    if isinstance(ball, BallOutline):
        return ball
    if isinstance(ball, str):
        if ball != "auto":
            raise InputError(f"ball: expected auto, a mask or (x, y, radius), got {ball!r}")
        return _named(name, ball_from_photo, image, None, focal, principal_point)
    numbers = np.asarray(ball)
    if numbers.ndim == 1 and numbers.shape == (3,) and numbers.dtype.kind in "uif":
        camera: Intrinsics = intrinsics_of(image.shape[:2], focal, principal_point)
        return outline_of_ellipse(
            Ellipse.circle(*numbers.astype(float).tolist(), std=_BY_HAND), camera
        )
    if numbers.ndim >= 2 and coverage_of(numbers).shape != image.shape[:2]:
        raise InputError(
            f"{name}: expected a mask of {image.shape[1]} x {image.shape[0]} pixels, "
            f"got {numbers.shape[1]} x {numbers.shape[0]}"
        )
    return _named(name, ball_from_mask, numbers, focal, principal_point)
