"""Images to an MP4 file, by the ffmpeg that comes with imageio-ffmpeg."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from geofem.mistake import Mistake
from geofem.study.fields import Array

PAUSE = 0.8
"""Seconds that the last frame stands."""


def ffmpeg() -> str:
    """The program that encodes. Raises ``Mistake`` if there is none."""
    try:
        import imageio_ffmpeg

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError, OSError):
        raise Mistake("film: there is no ffmpeg; 'uv sync' brings it, or name one in IMAGEIO_FFMPEG_EXE") from None


def encode(images: Iterable[Array], fps: float, path: Path) -> Path:
    """Write the images, (height, width, 3) of bytes and even sizes, as H.264 that every browser plays.

    Raises ``Mistake`` if ffmpeg cannot; an earlier film then stays as it was.
    """
    stream = iter(images)
    image = next(stream)
    part = path.with_name(f"{path.stem}.part{path.suffix}")
    height, width = image.shape[:2]
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:.4g}", "-i", "-"]
    # Colours of high-definition video, said in the file, or players would shift them.
    colours = ["-vf", "scale=out_color_matrix=bt709:out_range=tv", "-colorspace", "bt709", "-color_primaries", "bt709",
               "-color_trc", "bt709"]  # fmt: skip
    codec = ["-c:v", "libx264", "-preset", "medium", "-crf", "20", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    command = [ffmpeg(), "-y", "-v", "error", *source, "-an", *colours, *codec, str(part)]
    try:
        with tempfile.TemporaryFile() as said:
            with (
                suppress(BrokenPipeError),  # ffmpeg has ended, and said why
                subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said) as process,
            ):
                assert process.stdin is not None
                try:
                    process.stdin.write(image)
                    for image in stream:
                        process.stdin.write(image)
                    for _ in range(round(PAUSE * fps)):
                        process.stdin.write(image)
                except BrokenPipeError:
                    raise
                except BaseException:
                    process.kill()
                    raise
            said.seek(0)
            why = said.read().decode(errors="replace").strip().splitlines()
        if process.wait() != 0:
            raise Mistake(f"film: ffmpeg ended with {process.returncode}: {why[-1] if why else 'no message'}")
        part.replace(path)
    except OSError as error:
        raise Mistake(f"film: {error}; 'uv sync' brings an ffmpeg that works") from None
    finally:
        part.unlink(missing_ok=True)
    return path
