"""Fuzzing: broken scene files and pictures, and the promises that hold for all of them.

Each file is read, or refused in one line with the position of the mistake. No other error is
raised, no file hangs, and a header that only promises pixels takes no memory. Case n is the same in
every run.
"""

import dataclasses
import json
import random
import re
import resource
import signal
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import jax
import numpy as np
import OpenImageIO as oiio
from helpers.scenes import assert_same
from hypothesis import HealthCheck, given, settings, strategies as strategy

import spheretrace_jax as st

SECONDS, MEGABYTES = 10, 1000  # limits of one file and of all files together

# --- scenes ---------------------------------------------------------------------------------------

TEXTURES = ("a.exr", "two words.exr")

#: Scene files: all kinds of lines, the lecture's file, and an empty scene.
SCENES = {
    "every line": """\
0.1 1.5 500 800 // theta phi mu distance
1
2
100 500 800
-100 500 800 .5 .5 1 // a blue one
2
1 2 3 40  .9 .1 0  .2 .7 .1  4  .1 0 0
9 8 7 6  .9 .1 0  .2 .7 .1  4  0 .5 2
texture a.exr
texture "two words.exr"
background .1 .2 .3
background_image a.exr
back_plane .1 .2 .3 .4 .5
plane 0 0 -9 0 0 1 .5 .5 .5 .2 .8 0 1 .1
plane 0 0 -9 0 1 1 .5 .5 .5 .2 .8 0 1 .1 checker 1 1 1 60
window 300
roll .1
look_at 1 2 3
principal_point .1 .2
pixel_aspect 1.1
orthographic
""",
    "nine spheres": (Path(__file__).parents[2] / "data" / "nine_spheres.txt").read_text(),
    "nothing": "0 0 1 1 0 0\n0",
}

_WORDS = [
    *("0", "-0", "+1", "-1", ".5", "1.", "1e39", "-1e39", "1e400", "1e-46", "1e-400", "1_0"),
    *("nan", "inf", "-inf", "٣", "1,5", "999999999999999999", "9" * 500, "1e999999999", "0x10"),
    *("texture", "plane", "checker", "window", "background", "back_plane", "fog", "--1", "1e"),
    *("roll", "look_at", "orthographic"),
    *('"', '""', '"two words.exr"', '"two', "a.exr", ".", "..", "/", "//", "x" * 300),
    *("\ufeff", "\u2028", "\x0b", "\x85", "\x9b31m", "\u202e", "é", "\n", "\r", "\t", " ", "\0"),
]
_words = strategy.sampled_from(_WORDS) | strategy.floats().map(str) | strategy.text(max_size=6)


@strategy.composite
def broken_scenes(draw) -> bytes:
    """Draws a scene file with changed words, then changed bytes."""
    words = re.findall(r"\s+|\S+", SCENES[draw(strategy.sampled_from(sorted(SCENES)))])
    for _ in range(draw(strategy.integers(0, 3))):
        k, word = (
            draw(strategy.integers(0, len(words) - 1)),
            draw(_words | strategy.sampled_from(words)),
        )
        edits = ([word], [words[k], word], [], [words[k]] * 2, words[k : k + 3][::-1])
        words[k : k + 1] = draw(strategy.sampled_from(edits))
        words = words or [""]
    data = bytearray("".join(words).encode())
    for _ in range(draw(strategy.integers(0, 2))):
        k, byte = draw(strategy.integers(0, len(data))), draw(strategy.integers(0, 255))
        deleted = draw(strategy.sampled_from([0, 1, 1, 5, len(data)]))
        data[k : k + deleted] = draw(strategy.sampled_from([b"", bytes([byte]), bytes([byte]) * 5]))
    return bytes(data)


def fuzz_scenes(count: int) -> "Tally":
    """Reads broken scene files; Hypothesis shows the shortest of those that break a promise."""
    tally = Tally()
    with tempfile.TemporaryDirectory() as name:
        for texture in TEXTURES:
            st.write_image(Path(name) / texture, np.full((2, 3, 3), 0.5))

        @settings(
            max_examples=count, deadline=None, derandomize=True, database=None,
            suppress_health_check=list(HealthCheck),
        )  # fmt: skip
        @given(data=broken_scenes(), dtype=strategy.sampled_from([np.float32, np.float64]))
        def check(data: bytes, dtype: type) -> None:
            file = Path(name) / "scene.txt"
            file.write_bytes(data)
            with tally.one():
                scene = message = None
                try:
                    scene = st.load_scene(file, dtype)
                except st.SceneError as error:
                    message = str(error)
            tally.count(scene is not None)
            if scene is None:
                position = rf"{re.escape(str(file))}:[1-9]\d*:[1-9]\d*: "
                assert (
                    re.match(position, message) and message.isprintable() and len(message) < 1000
                ), message
            else:
                is_sane(scene, Path(name) / "again.txt")

        before = signal.signal(signal.SIGALRM, _late)
        try:
            check()
        finally:
            signal.signal(signal.SIGALRM, before)
    return tally


def _late(*_) -> None:
    raise TimeoutError(f"not read within {SECONDS} s")


def is_sane(scene: st.Scene, file: Path) -> None:
    """Asserts that all numbers are finite and that a file keeps every bit."""
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(scene))
    st.save_scene(file, scene)
    assert_same(st.load_scene(file, scene.dtype), scene)


# --- pictures -------------------------------------------------------------------------------------

# formats of write_image with their bits, and formats that only read_image knows
_OURS = {"a.png": 8, "b.png": 16, "a.exr": 32, "b.exr": 16, "a.hdr": 32, "a.ppm": 8, "b.ppm": 16,
         "a.tif": 8, "b.tif": 32, "a.jpg": 8}  # fmt: skip
_OTHERS = ("a.bmp", "a.tga", "a.webp", "a.sgi", "a.ico")
_SIZES = [0, 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 16_000, 32_000]


def good_pictures(folder: Path) -> dict[str, bytes]:
    """Writes small pictures in many formats to a folder and returns their bytes."""
    image = np.random.default_rng(0).uniform(0, 1, (6, 5, 3)).astype(np.float32)
    for name, bits in _OURS.items():
        text = SCENES["nothing"] if name.startswith("a") else None
        st.write_image(folder / name, image, bits=bits, scene=text)
    for name in _OTHERS:
        sink = oiio.ImageOutput.create(str(folder / name))
        assert sink.open(str(folder / name), oiio.ImageSpec(5, 6, 3, "uint8")), sink.geterror()
        assert sink.write_image(image) and sink.close()
    return {name: (folder / name).read_bytes() for name in (*_OURS, *_OTHERS)}


def broken_picture(good: dict[str, bytes], case: int) -> tuple[str, bytes]:
    """Returns a file's name and its picture with changed bytes, more often in the header."""
    draw = random.Random(case)
    name = draw.choice(sorted(good))
    data = bytearray(good[name])
    within = draw.choice([32, 64, 256, len(data)])
    for _ in range(draw.choice([1, 1, 2, 4, 16])):
        k = draw.randrange(max(1, min(within, len(data))))
        size = draw.choice(_SIZES)
        deleted, new = draw.choice(
            [
                (1, bytes([draw.randrange(256)])),
                (1, bytes([draw.choice([0, 1, 0x7F, 0x80, 0xFF])])),
                (draw.choice([1, 2, 4, 50]), b""),
                (0, draw.randbytes(draw.choice([1, 2, 4, 50]))),
                (4, struct.pack(draw.choice([">I", "<I"]), size)),
                (draw.choice([1, 2, 3]), str(size).encode()),
                (len(data), b""),
            ]
        )
        data[k : k + deleted] = new
    if name.endswith(".png") and draw.random() < 0.7:
        data = _signed(data)
    return name, bytes(data)


def _signed(data: bytearray) -> bytearray:
    """Corrects the checksums of a PNG file's chunks, without which no reader looks into them."""
    offset = 8
    while offset + 12 <= len(data):
        (size,) = struct.unpack_from(">I", data, offset)
        if offset + 12 + size > len(data):
            break
        struct.pack_into(
            ">I", data, offset + 8 + size, zlib.crc32(data[offset + 4 : offset + 8 + size])
        )
        offset += 12 + size
    return data


def fuzz_pictures(first: int, count: int) -> "Tally":
    """Reads broken pictures in another process, which a crash of a library would end."""
    done = subprocess.run(
        [sys.executable, "-m", "helpers.fuzz", str(first), str(count)],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
    )
    lines = done.stdout.splitlines()
    assert done.returncode == 0, f"{lines[-1:]} {done.returncode} {done.stderr[-500:]}"
    return Tally(**json.loads(lines[-1]))


def _read_pictures(first: int, count: int) -> None:
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # ends the process, also in a library
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        good = good_pictures(folder)
        for file in good:
            st.read_image(folder / file)  # libraries that are loaded on first use do not count
        tally = Tally()
        for case in range(first, first + count):
            file, data = broken_picture(good, case)
            print(case, file, flush=True)
            (folder / file).write_bytes(data)
            with tally.one():
                message = None
                try:
                    image = st.read_image(folder / file)
                except st.PictureError as error:
                    message = str(error)
            tally.count(message is None)
            if message is None:
                assert image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.float32
            else:
                assert message.startswith(f"{folder / file}: ") and message.isprintable(), message
                assert len(message) < 1000, message
    print(json.dumps(dataclasses.asdict(tally)))


# --- both -----------------------------------------------------------------------------------------


def peak() -> int:
    """Returns the most memory that this process ever held, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


@dataclasses.dataclass
class Tally:
    """The results of reading many files."""

    read: int = 0
    refused: int = 0
    slowest: float = 0.0  #: seconds
    grown: int = 0  #: MB, all together

    @contextmanager
    def one(self) -> Iterator[None]:
        """Measures the reading of one file and asserts its limits."""
        start, before = time.perf_counter(), peak()
        signal.alarm(SECONDS)
        try:
            yield
        finally:
            signal.alarm(0)
        self.slowest = max(self.slowest, time.perf_counter() - start)
        self.grown += peak() - before
        assert self.grown < MEGABYTES

    def count(self, read: bool) -> None:
        self.read, self.refused = self.read + read, self.refused + (not read)

    def __str__(self) -> str:
        return (
            f"{self.read} were read, {self.refused} refused; the slowest took {self.slowest:.2f} "
            f"s, memory grew by {self.grown} MB"
        )


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    _read_pictures(*map(int, sys.argv[1:]))
