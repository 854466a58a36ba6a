"""Motions that may not show: of the world with the camera, and of one camera number by another."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from ...base.vec import Vec, components
from ...scene.camera import Camera, view_frame
from ...scene.pose import view_axes
from .evidence import Arrays, Direction, Evidence


def motion_reasons(evidence: Evidence) -> Iterator[tuple[str, list[Direction]]]:
    """Yields motions of everything together with the eye, and the growth of everything."""
    free, camera = set(evidence.free), evidence.scenes[0].camera
    scale = "the scale of the world is not determined"
    if "radius" in free and not camera.orthographic:
        mu = [float(scene.camera.mu) for scene in evidence.scenes]
        yield scale, [_Growth(evidence, mu)]
    for name in ("mu", "theta", "phi", "roll", "look_at"):
        if name in free:
            yield _against_world(evidence, name)
    if {"radius", "mu"} <= free and not camera.orthographic:
        # around where a plane stays, or what several eyes look at
        planes, back = evidence.scenes[0].planes, _backward(camera)
        feet = [
            float(np.dot(p - _middle(camera), n) / slope)
            for p, n in zip(np.asarray(planes.point), np.asarray(planes.normal), strict=True)
            if (slope := back @ n)
        ]
        for around in (*feet, 0.0):
            yield scale, [_Growth(evidence, [around] * len(evidence.scenes))]


def exchange_reasons(evidence: Evidence) -> Iterator[tuple[str, list[Direction]]]:
    """Yields numbers of the camera that grow as others make up for it.

    The principal point is made up for by a shift of the camera or of the world, exactly in a
    parallel view, and nearly where a narrow view looks from far away.
    """
    free, camera = set(evidence.free), evidence.scenes[0].camera
    if "principal_point" in free:
        yield _against_world(evidence, "principal_point")
    if camera.orthographic and "look_at" in free:
        along: Direction = lambda k: {"look_at": _backward(evidence.scenes[k].camera)}
        yield "the camera's look_at along its axis is not determined", [along]
    for name, other in (("mu", "look_at"), ("roll", "theta"), ("principal_point", "look_at")):
        if {name, other} <= free:
            yield (
                f"the camera's {name} against its {other} is not determined",
                [_Exchange(evidence, name, i) for i in range(_numbers(evidence, name))],
            )
    if camera.orthographic and "center" in free:
        yield (
            "the distance of the world from the orthographic camera is not determined",
            [_WithWorld(evidence, "", 0)],
        )


def _against_world(evidence: Evidence, name: str) -> tuple[str, list[Direction]]:
    """Returns that a parameter of the camera changes as the world moves with the eye."""
    directions: list[Direction] = [
        _WithWorld(evidence, name, i) for i in range(_numbers(evidence, name))
    ]
    return f"the camera's {name} against the world is not determined", directions


def _numbers(evidence: Evidence, name: str) -> int:
    """Counts the numbers of a parameter of the camera."""
    return int(np.size(evidence.natural[0][name]))


def _row(v: Vec) -> np.ndarray:
    return np.array([float(x) for x in components(v)])


def _backward(camera: Camera) -> np.ndarray:
    """Returns the camera's axis, from what the eye looks at to the eye."""
    return -_row(view_frame(camera).forward)


def _middle(camera: Camera) -> np.ndarray:
    """Returns what the eye looks at."""
    return np.zeros(3) if camera.look_at is None else np.asarray(camera.look_at, np.float64)


@dataclasses.dataclass(frozen=True)
class _Growth:
    """A direction in which all lengths grow around one point on each camera's axis."""

    evidence: Evidence
    around: list[float]  #: the points' distances from what the eye looks at, for each picture

    def __call__(self, k: int) -> Arrays:
        natural, around = self.evidence.natural[k], self.around[k]
        camera = self.evidence.scenes[k].camera
        point = _middle(camera) + around * _backward(camera)
        growing = {n: natural[n] for n in ("radius",) if n in natural}
        growing |= {n: natural[n] - around for n in ("mu",) if n in natural}
        positions = {n: natural[n] for n in ("center", "light_position") if n in natural}
        return growing | {n: x - point for n, x in positions.items()}


@dataclasses.dataclass(frozen=True)
class _WithWorld:
    """A direction in which spheres and lights move with the eye as one number of it grows."""

    evidence: Evidence
    name: str  #: "" for the distance from an orthographic camera, which no number is
    index: int  #: which of the numbers

    def __call__(self, k: int) -> Arrays:
        natural, camera = self.evidence.natural[k], self.evidence.scenes[k].camera
        positions = {n: natural[n] for n in ("center", "light_position") if n in natural}
        moved: Arrays = {n: self._velocity(x, camera, k) for n, x in positions.items()}
        if "light_direction" in natural and self.name in ("theta", "phi", "roll"):
            direction = natural["light_direction"]
            moved["light_direction"] = np.cross(_axis(camera, self.name), direction)
        return moved | (_unit(natural, self.name, self.index) if self.name else {})

    def _velocity(self, position: np.ndarray, camera: Camera, k: int) -> np.ndarray:
        if self.name in ("", "mu"):
            step = _backward(camera)
        elif self.name == "look_at":
            step = np.eye(3)[self.index]
        elif self.name == "principal_point":
            step = -_shift(self.evidence, k, self.index)
        else:
            return np.cross(_axis(camera, self.name), position - _middle(camera))
        return np.broadcast_to(step, position.shape)


@dataclasses.dataclass(frozen=True)
class _Exchange:
    """A direction in which one number of the camera grows, and another makes up for it."""

    evidence: Evidence
    name: str  #: mu and principal_point for look_at, roll for theta
    index: int

    def __call__(self, k: int) -> Arrays:
        natural, camera = self.evidence.natural[k], self.evidence.scenes[k].camera
        if self.name == "mu":
            other: Arrays = {"look_at": -_backward(camera)}
        elif self.name == "roll":  # where the eye looks straight up or down
            along = float(_axis(camera, "roll") @ _axis(camera, "theta"))
            other = {"theta": -np.sign(along) * np.ones_like(natural["theta"])}
        else:
            other = {"look_at": _shift(self.evidence, k, self.index)}
        return other | _unit(natural, self.name, self.index)


def _unit(natural: Arrays, name: str, index: int) -> Arrays:
    """Returns that one number of a parameter grows by 1."""
    growth = np.zeros_like(natural[name])
    growth.reshape(-1)[index] = 1
    return {name: growth}


def _axis(camera: Camera, name: str) -> np.ndarray:
    """Returns the axis about which an angle turns the camera, by the right-hand rule."""
    if name == "theta":
        return np.array([0.0, 0, 1])
    right, _, forward = view_axes(camera.theta, camera.phi, None)
    return _row(right if name == "phi" else forward)


def _shift(evidence: Evidence, k: int, index: int) -> np.ndarray:
    """Returns how far a camera that moves across its view shifts the picture by its height.

    In perspective at the depth of the spheres' middle, and by the less at other depths.
    """
    scene = evidence.scenes[k]
    camera, frame = scene.camera, view_frame(scene.camera)
    size = float(camera.window)
    if not camera.orthographic and len(scene.spheres):
        middle = np.asarray(scene.spheres.center, np.float64).mean(axis=0)
        size *= float((middle - _row(frame.eye)) @ _row(frame.forward) / camera.distance)
    if index == 1:
        return -size * _row(frame.up)
    wide = 1 if camera.pixel_aspect is None else float(camera.pixel_aspect)
    return size * wide * _row(frame.right)
