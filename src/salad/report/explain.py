"""Pictures of what the model saw: the dustbin and the clusters over a photo, matches side by side.

    TokenAssignment ──> layer, one pixel a token ──> over the photo ──> strip of matches

The model squeezes a whole photo and crops nothing, so a layer stretched over the photo lies where its tokens were.
"""

from __future__ import annotations

import base64
import colorsys
import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from salad.errors import ModelError

if TYPE_CHECKING:
    from salad.models.describer import DescriberLike, PhotoLike, TokenAssignment


# Colours of the dustbin's heat: a little, as the photo's mean and more, all of a token.
EMBER = ((255, 196, 61), (226, 61, 40), (122, 14, 66))
# Frames of a match at the right place, at a wrong one, and where nobody knows.
RIGHT, WRONG, PLAIN = (15, 124, 134), (208, 72, 38), (120, 124, 130)


def share_of(model: DescriberLike, photo: PhotoLike) -> TokenAssignment | None:
    """Where a photo's tokens went, or None for a model without a dustbin."""
    assigned = getattr(model, "token_assignment", None)
    if assigned is None:
        return None
    try:
        found: TokenAssignment = assigned(photo)
    except ModelError:
        return None
    return found


def heat(share: TokenAssignment) -> NDArray[np.float32]:
    """How hot to draw each token, `[rows, columns]` in 0..1, rising with the dustbin's share of it.

    With many tokens and few clusters the dustbin takes most of nearly every token, so its plain share would
    paint the photo in one colour. A power brings the photo's mean to 0.5; nothing stays 0 and all stays 1.
    """
    shares = np.clip(np.asarray(share.dustbin, dtype=np.float64), 0, 1)
    mean = float(np.clip(shares.mean(), 0.01, 0.999))
    return np.asarray(shares ** (math.log(0.5) / math.log(mean)), dtype=np.float32)


def dustbin_layer(share: TokenAssignment) -> Image.Image:
    """What the dustbin took, as RGBA with one pixel a token: clear where a token counts, ember where not."""
    heats = heat(share).astype(np.float64)
    # Alpha rises with the heat too, so that what counts is seen as it is.
    colours = np.array(EMBER, dtype=np.float64)
    pixels = np.empty((*heats.shape, 4))
    for channel in range(3):
        pixels[..., channel] = np.interp(heats, (0.3, 0.65, 1.0), colours[:, channel])
    pixels[..., 3] = 255 * np.interp(heats, (0.0, 0.35, 0.65, 1.0), (0.0, 0.08, 0.5, 0.8))
    return Image.fromarray(np.rint(pixels).astype(np.uint8))


def cluster_layer(share: TokenAssignment) -> Image.Image:
    """Which cluster each token went to, as RGBA with one pixel a token; faint where the dustbin took most."""
    clusters = np.asarray(share.cluster, dtype=np.int64)
    palette = np.array([cluster_colour(number) for number in range(int(clusters.max(initial=0)) + 1)])
    alpha = 255 * np.interp(heat(share), (0.0, 1.0), (0.64, 0.08))
    pixels = np.concatenate([palette[clusters], np.rint(alpha)[..., None]], axis=-1)
    return Image.fromarray(pixels.astype(np.uint8))


def cluster_colour(number: int) -> tuple[int, int, int]:
    """The colour of a cluster, the same in every photo; neighbours in number are far apart in hue."""
    hue = number * 0.618_033_988_75 % 1.0  # the golden ratio never comes back to a hue
    light = (0.62, 0.48, 0.74)[number % 3]
    red, green, blue = colorsys.hls_to_rgb(hue, light, 0.62)
    return round(255 * red), round(255 * green), round(255 * blue)


def laid_over(photo: Image.Image, layer: Image.Image) -> Image.Image:
    """The photo, RGB, with a layer stretched over the whole of it, each token a block with sharp edges."""
    # Nearest, not smooth: a token is a block of the photo, and its edges say where it ends.
    stretched = layer.resize(photo.size, Image.Resampling.NEAREST)
    return Image.alpha_composite(photo.convert("RGBA"), stretched).convert("RGB")


def dustbin_over(photo: Image.Image, share: TokenAssignment) -> Image.Image:
    """The photo under what the dustbin took of it."""
    return laid_over(photo, dustbin_layer(share))


def clusters_over(photo: Image.Image, share: TokenAssignment) -> Image.Image:
    """The photo under the clusters its tokens went to."""
    return laid_over(photo, cluster_layer(share))


def match_strip(
    query: Image.Image,
    references: Sequence[Image.Image],
    *,
    captions: Sequence[str] = (),
    right: Sequence[bool | None] = (),
    height: int = 240,
) -> Image.Image:
    """A query and its best references side by side on white, the query first and a little apart.

    Args:
        query: The photo in question.
        references: What it was matched with, best first; every picture keeps its shape.
        captions: A line below each picture, the query's first; missing ones stay empty.
        right: Whether each reference shows the query's place, drawn as its frame; None or missing: nobody knows.
        height: Of every picture, in pixels, at least 16.

    Raises:
        ModelError: The height is too small to show anything.
    """
    if height < 16:
        raise ModelError(f"a strip {height} pixels high shows nothing: give a height of 16 or more")
    pictures = [
        picture.convert("RGB").resize(
            (max(1, round(picture.width * height / picture.height)), height), Image.Resampling.LANCZOS
        )
        for picture in (query, *references)
    ]
    frames = {True: RIGHT, False: WRONG, None: PLAIN}
    gap, edge, line = max(4, height // 30), max(2, height // 60), max(12, height // 9)
    gaps = [0, *(4 * gap if n == 0 else gap for n in range(len(references)))]
    width = sum(picture.width for picture in pictures) + sum(gaps) + 2 * gap
    strip = Image.new("RGB", (width, height + line + 2 * gap + (gap if captions else -line)), "white")
    draw = ImageDraw.Draw(strip)
    at = gap
    for number, (picture, before) in enumerate(zip(pictures, gaps, strict=True)):
        at += before
        strip.paste(picture, (at, gap))
        if number:
            colour = frames[right[number - 1] if number <= len(right) else None]
            draw.rectangle((at, gap, at + picture.width - 1, gap + height - 1), outline=colour, width=edge)
        if number < len(captions):
            write_line(draw, captions[number], (at, height + 2 * gap), size=0.72 * line, width=picture.width)
        at += picture.width
    return strip


def data_uri(image: Image.Image, *, quality: int = 80) -> str:
    """The picture inside a line of text: RGBA as PNG, everything else as JPEG."""
    buffer, kind = io.BytesIO(), "png" if image.mode == "RGBA" else "jpeg"
    if kind == "png":
        image.save(buffer, "PNG", optimize=True)
    else:
        image.convert("RGB").save(buffer, "JPEG", quality=quality, optimize=True, progressive=True)
    return f"data:image/{kind};base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def write_line(draw: ImageDraw.ImageDraw, text: str, at: tuple[int, int], *, size: float, width: int) -> None:
    """One line of text, cut to `width` pixels."""
    font = ImageFont.load_default(size)
    line = " ".join(text.split())
    while line and draw.textlength(line, font=font) > width:
        line = line[:-2].rstrip() + "…" if len(line) > 2 else ""
    draw.text(at, line, fill=(51, 54, 60), font=font)
