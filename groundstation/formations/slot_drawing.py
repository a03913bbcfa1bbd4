"""Slots that draw a text or an image.

The slots are spread evenly over the dark part of the picture, so that thin strokes become lines.
"""

from __future__ import annotations

import math
import os
import struct
import warnings
from io import BytesIO
from typing import Any

import numpy as np

from onboard.arrays import Array
from onboard.config.file_reading import FONT, PICTURE, opened, read_bytes
from onboard.config.fleet import ConfigError

_HEIGHT_PX = 48  # height of a text
_MAX_PX = 150  # pixels of an image's longer side that are used
_ROUNDS = 40  # largest number of iterations of the spreading
_SETTLED_PX = 1e-3  # the spreading ends when no centre moves by more
# exceptions that Pillow raises on damaged parts of an image
_DAMAGED = (OSError, ValueError, SyntaxError, LookupError, TypeError, struct.error)
_MAX_PIXELS = 25_000_000  # pixels of an image; they take 300 MB while it is read
_FORMATS = ("PNG", "JPEG", "GIF", "BMP", "WEBP")


def text_slots(text: str, font: str | None, count: int) -> Array:
    """Return slots (N, 3) that write a text, read from the south.

    Args:
        text: one line.
        font: file of a font; None: the default font of matplotlib.
        count: number of slots.

    Raises:
        ConfigError: matplotlib is not installed, the font cannot be read, or it lacks a letter.
    """
    matplotlib = _matplotlib()
    if font is not None:
        opened(font, FONT).close()  # refuses what is not a regular file, or is too large for a font
    try:
        properties = matplotlib.font_manager.FontProperties(fname=font)
        font_file = matplotlib.font_manager.findfont(properties)
        # Refuses a wrong font. Matplotlib would refuse it too, but after it has opened another
        # font, which it never closes.
        opened_font = matplotlib.ft2font.FT2Font(font_file)
        _refuse_missing_letters(text, opened_font)
        # between two dollar signs, matplotlib reads mathematics
        plain = text.replace("$", r"\$")
        outline = matplotlib.textpath.TextPath((0.0, 0.0), plain, size=_HEIGHT_PX, prop=properties)
    except ConfigError:
        raise
    except (OSError, RuntimeError, ValueError) as error:
        raise ConfigError(
            f"{font}: this font cannot be read ({error}). Name a .ttf or .otf."
        ) from None
    except AttributeError:  # matplotlib makes no path of a text in which nothing is drawn
        raise _invisible(text) from None
    polygons = [matplotlib.path.Path(points) for points in outline.to_polygons()]
    if not polygons:
        raise _invisible(text)

    # the middle of each pixel of the box around the text
    corners = np.concatenate([polygon.vertices for polygon in polygons])
    low = np.floor(corners.min(0))
    high = np.ceil(corners.max(0))
    x, y = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
    pixels = np.column_stack([x.ravel(), y.ravel()])

    # Exclusive or, because the hole of an O is a separate polygon.
    inside = np.logical_xor.reduce([polygon.contains_points(pixels) for polygon in polygons])
    return _spread(pixels[inside], count, f"The text {text!r}")


def _refuse_missing_letters(text: str, font: Any) -> None:
    """Refuse a text with letters in whose place the font has a box.

    Raises:
        ConfigError: a letter is missing.
    """
    missing = [letter for letter in dict.fromkeys(text) if not font.get_char_index(ord(letter))]
    if missing:
        raise ConfigError(
            f"The font {font.family_name} has no {', '.join(map(repr, missing))} for the text "
            f"{text!r}. Write it with other letters, or name a font that has them."
        )


def _invisible(text: str) -> ConfigError:
    """Return the refusal for a text in which nothing is drawn."""
    return ConfigError(f"The text {text!r} has no visible letter. Write another one.")


def image_slots(file: str, count: int) -> Array:
    """Return slots (N, 3) over the dark part of an image, its upper edge in the north.

    Args:
        file: an image in one of the formats in _FORMATS.
        count: number of slots.

    Raises:
        ConfigError: matplotlib is not installed, there is no such image, or it is too large.
    """
    pixels = _pixels(file)
    grey = pixels[..., :3].mean(-1)
    opacity = pixels[..., 3]
    grey = grey * opacity + 1.0 - opacity  # on white

    is_drawn = grey < 0.5
    if is_drawn.mean() > 0.5:
        is_drawn = ~is_drawn  # most pixels are dark, so the drawing is light on dark
    rows, columns = np.nonzero(is_drawn)
    return _spread(np.column_stack([columns, -rows]).astype(float), count, f"{file}")


def _pixels(file: str) -> Array:
    """Return red, green, blue and opacity, each up to 1, of at most _MAX_PX by _MAX_PX pixels.

    Raises:
        ConfigError: there is no such image, it has too many pixels, or its format is not read.
    """
    _matplotlib()  # brings Pillow
    from PIL import Image, UnidentifiedImageError

    data = read_bytes(file, PICTURE)
    try:
        # Pillow warns of large pictures and of wrong animations, some of them while it unpacks.
        # To open an image reads only its header, which has the size.
        with (
            warnings.catch_warnings(action="ignore"),
            Image.open(BytesIO(data), formats=_FORMATS) as image,
        ):
            return _unpacked(image, file)
    except UnidentifiedImageError:
        formats = ", ".join(_FORMATS)
        raise ConfigError(f"{file}: this image is none of {formats}. Give a PNG.") from None
    except Image.DecompressionBombError:
        raise ConfigError(
            f"{file}: this image has far more than {_MAX_PIXELS // 1_000_000} million pixels, the "
            "most that is read. Make it smaller."
        ) from None
    except ConfigError:
        raise
    except _DAMAGED as error:
        raise ConfigError(f"{file}: this image cannot be read ({error}). Give a PNG.") from None


def _unpacked(image: Any, file: str) -> Array:
    """Return the pixels of an opened image, at most _MAX_PX by _MAX_PX of them.

    Raises:
        ConfigError: it has too many pixels.
    """
    width_px, height_px = image.size
    if width_px * height_px > _MAX_PIXELS:
        raise ConfigError(
            f"{file}: this image has {width_px} x {height_px} pixels; "
            f"{_MAX_PIXELS // 1_000_000} million are the most that is read. Make it smaller."
        )

    step = math.ceil(max(image.size) / _MAX_PX)
    if image.mode.startswith("I"):  # grey of 16 bits, which `convert` would limit to 255
        grey = np.asarray(image)[::step, ::step] / 65_535.0
        return np.stack([grey, grey, grey, np.ones_like(grey)], axis=-1)
    return np.asarray(image.convert("RGBA"))[::step, ::step] / 255.0


def _matplotlib() -> Any:
    try:
        import matplotlib.font_manager
        import matplotlib.ft2font
        import matplotlib.image
        import matplotlib.path
        import matplotlib.textpath
    except ImportError:
        raise ConfigError(
            "Formations from a text or an image need matplotlib, which is not installed here. "
            "Install Covey with [all]."
        ) from None
    return matplotlib


def _spread(pixels: Array, count: int, title: str) -> Array:
    """Return slots (N, 3), N = `count`: pixels of a drawing (P, 2), spread evenly over it.

    This is Lloyd's iteration (k-means): again and again each centre moves to the mean of the pixels
    that are nearest to it. The first centres are pixels that are far from each other.
    """
    if len(pixels) < count:
        raise ConfigError(
            f"{title} has {len(pixels)} dark pixels, too few for {count} slots. Draw it thicker."
        )

    # The first centre is the pixel farthest west (the small weight decides between equals). Each
    # further centre is the pixel that is farthest from all centres before it.
    centres = pixels[[int(np.argmin(pixels @ (1.0, -0.01)))]]
    distances = ((pixels - centres) ** 2).sum(-1)
    for _ in range(1, count):
        centres = np.concatenate([centres, pixels[[int(distances.argmax())]]])
        distances = np.minimum(distances, ((pixels - centres[-1]) ** 2).sum(-1))

    for _ in range(_ROUNDS):
        nearest = ((pixels[:, None] - centres[None]) ** 2).sum(-1).argmin(-1)
        sizes = np.bincount(nearest, minlength=count)
        sum_x = np.bincount(nearest, pixels[:, 0], minlength=count)
        sum_y = np.bincount(nearest, pixels[:, 1], minlength=count)
        means = np.column_stack([sum_x, sum_y]) / sizes[:, None]
        if np.abs(means - centres).max() < _SETTLED_PX:
            break
        centres = means

    # Each centre gets the nearest pixel that is not a slot yet.
    chosen: list[int] = []
    for centre in centres:
        distances = ((pixels - centre) ** 2).sum(-1)
        distances[chosen] = np.inf
        chosen.append(int(distances.argmin()))
    drawn = pixels[chosen]
    from_the_west = np.lexsort((-drawn[:, 1], drawn[:, 0]))
    return np.column_stack([drawn[from_the_west], np.zeros(count)])


def beside(path: str, file: str) -> str:
    """Return the path of a file that another file at `path` names."""
    return os.path.join(os.path.dirname(path), file)
