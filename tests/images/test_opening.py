"""Which files are opened, and the sentence for those that are not; before memory is taken."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import zlib
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from salad.errors import PhotoError
from salad.geo import GeoPoint, metres_between
from salad.images import decode
from salad.images.decode import open_rgb
from salad.images.exif import save_jpeg
from salad.images.finding import find_photos
from salad.images.photo import read_photo

COLOURS = (np.indices((48, 64)).sum(axis=0)[:, :, None] * [1, 2, 0] % 256).astype(np.uint8)


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(width: int, height: int, *chunks: bytes, bits: int = 1, colour: int = 0) -> bytes:
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(chunks)


def encoded(form: str, size: tuple[int, int] = (16, 16), **how: Any) -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", size, (9, 99, 199)).save(buffer, form, **how)
    return buffer.getvalue()


def refused(path: Path, content: bytes) -> str:
    """The sentence that `open_rgb` has for a file; its EXIF says nothing, in peace."""
    path.write_bytes(content)
    read_photo(path)
    with pytest.raises(PhotoError) as caught:
        open_rgb(path)
    said = str(caught.value)
    assert str(path) in said
    assert "\n" not in said
    return said


# --- HEIC ----------------------------------------------------------------------------------


@pytest.fixture
def heif() -> Any:
    return pytest.importorskip("pillow_heif", reason="the extra heic is not installed")


def heic(heif: Any, path: Path, pixels: np.ndarray, **how: Any) -> Path:
    heif.from_pillow(Image.fromarray(pixels)).save(path, quality=90, **how)
    return path


def test_heic_shows_its_colours(heif: Any, tmp_path: Path) -> None:
    seen = np.asarray(open_rgb(heic(heif, tmp_path / "IMG_0001.HEIC", COLOURS)), dtype=int)
    assert seen.shape == COLOURS.shape
    assert np.abs(seen - COLOURS).mean() < 8


@pytest.mark.parametrize("orientation", range(1, 9))
def test_heic_is_turned_once(heif: Any, tmp_path: Path, orientation: int) -> None:
    halves = np.zeros((64, 32, 3), np.uint8)
    halves[:32, :16] = 255  # a white corner at the top left
    exif = Image.Exif()
    exif[0x0112] = orientation
    heic(heif, tmp_path / "a.heic", halves, exif=exif.tobytes())
    Image.fromarray(halves).save(tmp_path / "a.png", exif=exif)
    seen, expected = (np.asarray(open_rgb(tmp_path / name), dtype=int) for name in ("a.heic", "a.png"))
    assert seen.shape == expected.shape
    assert np.abs(seen - expected).mean() < 8


def test_heic_knows_its_place(heif: Any, tmp_path: Path) -> None:
    here = GeoPoint(48.1, 11.5)
    save_jpeg(COLOURS, tmp_path / "a.jpg", where=here, heading=12)
    with Image.open(tmp_path / "a.jpg") as image:
        heic(heif, tmp_path / "a.heic", COLOURS, exif=image.info["exif"])
    photo = read_photo(tmp_path / "a.heic")
    assert photo.heading == 12
    assert photo.where is not None
    assert metres_between(photo.where, here) < 0.05


def test_what_is_transparent_or_grey_in_heic(heif: Any, tmp_path: Path) -> None:
    clear = np.zeros((32, 32, 4), np.uint8)
    assert np.asarray(open_rgb(heic(heif, tmp_path / "a.heic", clear))).min() > 250
    grey = np.asarray(open_rgb(heic(heif, tmp_path / "g.heic", np.full((32, 32), 99, np.uint8))), dtype=int)
    assert np.abs(grey - 99).max() < 5


def test_a_broken_heic_is_said(heif: Any, tmp_path: Path) -> None:
    whole = heic(heif, tmp_path / "a.heic", COLOURS).read_bytes()
    for cut in (20, 40, len(whole) // 2, len(whole) - 9):
        assert "damaged or cut short" in refused(tmp_path / "cut.heic", whole[:cut])


def test_without_the_extra_heic_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    for brand in (b"heic", b"heix", b"mif1", b"msf1"):
        said = refused(tmp_path / "a.heic", b"\0\0\0\x18ftyp" + brand + bytes(4) + b"mif1heic")
        assert "is HEIC" in said
        assert "pip install 'salad-vpr[heic]'" in said


def test_avif_is_not_taken_for_heic(tmp_path: Path) -> None:
    if "AVIF" not in Image.SAVE and not Image.init():
        pytest.skip("this Pillow writes no AVIF")
    content = encoded("AVIF", (64, 48))
    assert content[4:8] == b"ftyp"
    swapped = content[:8] + b"mif1" + content[12:]  # some writers name the family first
    for form in (content, swapped):
        (tmp_path / "a.avif").write_bytes(form)
        assert open_rgb(tmp_path / "a.avif").size == (64, 48)


# --- too large -----------------------------------------------------------------------------


def sized_jpeg(width: int, height: int) -> bytes:
    content = encoded("JPEG")
    frame = content.index(b"\xff\xc0") + 5
    return content[:frame] + struct.pack(">HH", height, width) + content[frame + 4 :]


def sized_gif(width: int, height: int, *, disposal: int = 0) -> bytes:
    screen = struct.pack("<HHBBB", width, height, 0xF0, 0, 0) + bytes(6)
    control = b"\x21\xf9\x04" + bytes([disposal << 2, 0, 0, 0, 0])
    frame = b"\x2c" + struct.pack("<HHHHB", 0, 0, width, height, 0)
    return b"GIF89a" + screen + control + frame + b"\x02\x02\x44\x01\0\x3b"


def sized_webp(width: int, height: int) -> bytes:
    canvas = b"VP8X" + struct.pack("<I", 10) + b"\0\0\0\0"
    canvas += (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
    body = b"WEBP" + canvas + encoded("WEBP")[12:]
    return b"RIFF" + struct.pack("<I", len(body)) + body


def sized_tiff(width: int, height: int, **tags: int) -> bytes:
    directory = ImageFileDirectory_v2()
    layout = {256: width, 257: height, 258: 8, 259: 8, 262: 1, 277: 1, 278: height, 273: 8, 279: 20}
    for tag, value in (layout | {int(name[1:]): value for name, value in tags.items()}).items():
        directory[tag] = value
        directory.tagtype[tag] = 4
    return b"II*\0" + struct.pack("<I", 8) + directory.tobytes(8) + zlib.compress(bytes(1000))


def sized_bmp(width: int, height: int) -> bytes:
    return b"BM" + struct.pack("<IHHIIiiHHIIiiII", 99, 0, 0, 54, 40, width, height, 1, 24, 0, 0, 0, 0, 0, 0) + b"x"


def sized_jp2(width: int, height: int) -> bytes:
    content = encoded("JPEG2000")
    header = content.index(b"ihdr") + 4
    return content[:header] + struct.pack(">II", height, width) + content[header + 8 :]


BOMBS = {
    "a.jpg": sized_jpeg(60_000, 60_000),
    "a.png": png(60_000, 60_000, chunk(b"IDAT", zlib.compress(bytes(100_000)))),
    "turned.gif": sized_gif(60_000, 60_000),
    "wiped.gif": sized_gif(60_000, 60_000, disposal=2),
    "a.webp": sized_webp(16_383, 16_383),
    "a.tif": sized_tiff(60_000, 60_000),
    "a.bmp": sized_bmp(60_000, 60_000),
    "a.ppm": b"P6 60000 60000 255\n" + bytes(100),
    "a.jp2": sized_jp2(60_000, 60_000),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_that_claims_to_be_huge_is_refused(tmp_path: Path, name: str) -> None:
    assert len(BOMBS[name]) < 10_000
    said = refused(tmp_path / name, BOMBS[name])
    assert "pixels, over" in said
    assert "save it smaller" in said


CHILD = """
import pathlib, resource, sys
from salad.errors import PhotoError
from salad.images.decode import open_rgb
from salad.images.photo import read_photo
def highest():
    # in KiB; ru_maxrss would remember the process this one was forked from
    status = pathlib.Path("/proc/self/status")
    if status.is_file():
        return next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
resource.setrlimit(resource.RLIMIT_AS, (1 << 30, 1 << 30))
for path in sorted(pathlib.Path(sys.argv[1]).iterdir()):
    read_photo(path)
    try:
        open_rgb(path)
        print("opened", path.name)
    except PhotoError as error:
        assert "more memory" not in str(error), error
print(highest())
"""


def taken(folder: Path) -> tuple[list[str], int]:
    """What a process of its own opens of the photos in a folder, and the KiB of memory it had at most."""
    pytest.importorskip("resource", reason="only Unix measures memory so")
    ran = subprocess.run([sys.executable, "-c", CHILD, folder], capture_output=True, encoding="utf-8", check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    *opened, memory = ran.stdout.splitlines()
    return opened, int(memory)


def test_bombs_take_no_memory(tmp_path: Path) -> None:
    text = zlib.compress(bytes(100_000_000), 9)
    pixels, end = chunk(b"IDAT", zlib.compress(bytes(2))), chunk(b"IEND", b"")
    heads = {b"zTXt": b"a\0\0", b"iTXt": b"a\0\1\0\0\0", b"iCCP": b"a\0\0"}
    inflated = {
        f"{number}{kind.decode()}.png": png(1, 1, *order, end)
        for kind, head in heads.items()
        for number, order in enumerate(permutations([pixels, chunk(kind, head + text)]))
    }
    for name, content in (BOMBS | inflated).items():
        (tmp_path / name).write_bytes(content)
    opened, memory = taken(tmp_path)
    assert set(opened) <= {f"opened {name}" for name in inflated}
    assert memory < 200_000  # nothing much beyond Python, numpy and Pillow


def test_a_jpeg_that_goes_over_its_pixels_for_minutes_is_refused(tmp_path: Path) -> None:
    content = encoded("JPEG", progressive=True)
    again = content[content.rindex(b"\xff\xda") : -2]
    (tmp_path / "a.jpg").write_bytes(content[:-2] + again * 20 + content[-2:])
    assert open_rgb(tmp_path / "a.jpg").size == (16, 16)
    assert "passes over its pixels" in refused(tmp_path / "a.jpg", content[:-2] + again * 100 + content[-2:])


def test_a_tile_larger_than_its_picture_is_refused(tmp_path: Path) -> None:
    tiled = sized_tiff(16, 16, t322=20_000, t323=20_000, t324=8, t325=20)
    assert "tiles of over 200000000 pixels" in refused(tmp_path / "a.tif", tiled)


def test_a_side_too_long_to_squeeze_is_refused(tmp_path: Path) -> None:
    line = png(1_000_001, 1, chunk(b"IDAT", zlib.compress(bytes(125_002))), chunk(b"IEND", b""))
    assert "over 1000000 on a side" in refused(tmp_path / "a.png", line)


def test_a_picture_without_pixels_is_said(tmp_path: Path) -> None:
    for content in (sized_tiff(0, 9), sized_tiff(9, 0), sized_gif(0, 0)):
        assert "pixels" in (said := refused(tmp_path / "a.tif", content)) or "not an image" in said


def test_want_of_memory_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def short(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("salad.images.decode.to_rgb", short)
    assert "more memory than there is" in refused(tmp_path / "a.png", encoded("PNG"))


# --- odd but sound -------------------------------------------------------------------------


def test_of_several_frames_the_first_is_shown(tmp_path: Path) -> None:
    frames = [Image.new("RGB", (8, 6), colour) for colour in ("red", "blue", "green")]
    for name in ("a.gif", "a.png", "a.webp", "a.tif", "a.mpo"):
        how = {"lossless": True} if name == "a.webp" else {}
        form = "MPO" if name == "a.mpo" else None
        frames[0].save(tmp_path / name, form, save_all=True, append_images=frames[1:], **how)
        seen = np.asarray(open_rgb(tmp_path / name), dtype=int)
        assert seen.shape == (6, 8, 3)
        assert np.abs(seen - [255, 0, 0]).max() <= 3


def test_a_wrong_suffix_is_no_matter(tmp_path: Path) -> None:
    for form in ("JPEG", "PNG", "WEBP", "TIFF"):
        (tmp_path / "a.gif").write_bytes(encoded(form))
        assert open_rgb(tmp_path / "a.gif").getpixel((3, 3)) == pytest.approx((9, 99, 199), abs=4)


@pytest.mark.parametrize(
    "name",
    [
        "with space.jpg",
        "@ home.jpg",
        "東京 é شارع 🚲.jpg",
        "-rf.jpg",
        "[a]*?.jpg",
        "%s{0}.jpg",
        "a'b\"c.jpg",
        "写" * 80 + ".jpg",
    ],
)
def test_names_in_any_script_and_folders_with_at_signs(tmp_path: Path, name: str) -> None:
    home = tmp_path / "@0545350.23@4174054.95@10@S@ us @ home"
    home.mkdir()
    save_jpeg(COLOURS, home / name, where=GeoPoint(1, 2))
    assert find_photos([tmp_path]) == [home / name]
    assert open_rgb(home / name).size == (64, 48)
    assert (where := read_photo(home / name).where) is not None
    assert (where.lat, where.lon) == pytest.approx((1, 2), abs=1e-6)


def test_a_name_that_is_no_text(tmp_path: Path) -> None:
    path = Path(bytes(tmp_path).decode(), b"caf\xe9.jpg".decode("utf-8", "surrogateescape"))
    try:
        save_jpeg(COLOURS, path)
    except PhotoError:
        pytest.skip("this file system takes names of text only")
    assert find_photos([tmp_path]) == [path]
    assert open_rgb(path).size == (64, 48)
    path.write_bytes(b"")
    with pytest.raises(PhotoError, match="is empty"):
        open_rgb(path)


def test_limits_fit_together() -> None:
    assert decode.MAX_PIXELS >= 199_800_000
    assert decode.MAX_SIDE > 65_535  # as long as a JPEG can be
