"""Whatever happens to the file of a mesh or a label image, there are cells or a ValueError, and soon."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
import trimesh

from slipmap.models.objects import cells_from_label_image, cells_from_mesh
from slipmap.models.objects.meshes import upright_mesh
from tests.mutations import refusals, spoilt

OBJECT = trimesh.creation.box(bounds=[[0, 0, 0], [0.12, 0.03, 0.02]])


def exported(kind: str, **options: object) -> bytes:
    content = OBJECT.export(file_type=kind, **options)
    return content.encode() if isinstance(content, str) else content


MESHES = {
    "stl": exported("stl"),
    "ascii.stl": exported("stl_ascii"),
    "obj": exported("obj"),
    "ply": exported("ply"),
    "ascii.ply": exported("ply", encoding="ascii"),
    "urdf": b'<robot name="a"><link name="b"><visual><origin xyz="0 0 0.01" rpy="0 0 0.3"/><geometry>'
    b'<box size="0.12 0.03 0.02"/></geometry></visual></link></robot>',
}


@pytest.mark.parametrize("kind", MESHES)
def test_spoilt_meshes(tmp_path, kind):
    path = tmp_path / f"box.{kind}"

    def read(content: bytes) -> None:
        path.write_bytes(content)
        grid = cells_from_mesh(path, count=10)
        assert np.isfinite(grid.centers).all()
        assert np.isfinite(upright_mesh(path).bounds).all()

    read(MESHES[kind])
    more = (b"vertex", b"facet", b"f 1 2 3\n", b"element vertex 999999999\n", b"v 1 1 1\n", b"property")
    _, refused = refusals(spoilt(MESHES[kind], 300, more), read, ValueError)
    assert refused > 30


def labels() -> np.ndarray:
    image = np.zeros((30, 40), np.uint8)
    image[5:25, 5:35] = 1
    image[5:15, 5:15] = 2
    return image


PICTURES = {kind: cv2.imencode(f".{kind}", labels())[1].tobytes() for kind in ("png", "bmp", "pgm", "tiff")}


def read_labels(path):
    def read(content: bytes) -> None:
        path.write_bytes(content)
        grid, segments = cells_from_label_image(path, 0.002, count=10)
        assert len(segments) == len(grid) and np.isfinite(grid.centers).all()

    return read


@pytest.mark.parametrize("kind", PICTURES)
def test_spoilt_label_images(tmp_path, kind):
    read = read_labels(tmp_path / f"labels.{kind}")
    read(PICTURES[kind])
    _, refused = refusals(spoilt(PICTURES[kind], 300), read, ValueError)
    assert refused > 30


def test_a_header_of_many_spaces_is_refused(tmp_path):
    """A pattern that tries every way to divide the spaces would never end."""
    with pytest.raises(ValueError, match="damaged"):
        read_labels(tmp_path / "labels.pgm")(b"P5" + b" " * 80 + b"x")


@pytest.mark.parametrize("kind", PICTURES)
def test_opencv_says_nothing_of_a_damaged_picture(tmp_path, capfd, kind):
    whole, loud = PICTURES[kind], cv2.utils.logging.getLogLevel()
    read = read_labels(tmp_path / f"labels.{kind}")
    cuts = [whole[: len(whole) * share // 10] for share in range(1, 10)]
    changed = [whole[:place] + b"\x55" + whole[place + 1 :] for place in range(20, len(whole), 5)]
    refusals(iter(cuts + changed), read, ValueError)
    assert capfd.readouterr() == ("", "")
    assert cv2.utils.logging.getLogLevel() == loud


def parts(content: bytes) -> list[tuple[bytes, bytes]]:
    """Names and contents of the chunks of a PNG file."""
    found, place = [], 8
    while place < len(content):
        (length,) = struct.unpack_from(">I", content, place)
        found.append((content[place + 4 : place + 8], content[place + 8 : place + 8 + length]))
        place += 12 + length
    return found


def joined(chunks: list[tuple[bytes, bytes]]) -> bytes:
    """A PNG file of chunks, with right checksums."""
    text = [
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    ]
    return b"".join((b"\x89PNG\r\n\x1a\n", *text))


def test_png_files_whose_checksums_are_right(tmp_path):
    read = read_labels(tmp_path / "labels.png")
    chunks = parts(PICTURES["png"])
    assert joined(chunks) == PICTURES["png"]
    files = []
    for number, (name, data) in enumerate(chunks):
        for content in spoilt(data, 100, seed=number) if data else ():
            files.append(joined([*chunks[:number], (name, content), *chunks[number + 1 :]]))
    _, refused = refusals(iter(files), read, ValueError)
    assert refused > 50


@pytest.mark.parametrize("high", [0x01, 0x7F, 0x80, 0xFF])
def test_a_length_that_cannot_be_is_not_believed(tmp_path, high):
    """OpenCV made room for it and took 5 to 16 s to see that the file ends before."""
    content = bytearray(PICTURES["png"])
    assert content[37:41] == b"IDAT"
    content[33] = high
    assert refusals(iter([bytes(content)]), read_labels(tmp_path / "labels.png"), ValueError) == (0, 1)


@pytest.mark.parametrize("kind", PICTURES)
def test_a_size_that_cannot_be_is_not_believed(tmp_path, kind):
    size = 30_000
    if kind == "png":
        header, *rest = parts(PICTURES["png"])
        content = joined([(header[0], struct.pack(">II", size, size) + header[1][8:]), *rest])
    elif kind == "bmp":
        content = PICTURES["bmp"][:18] + struct.pack("<ii", size, -size) + PICTURES["bmp"][26:]
    elif kind == "pgm":
        content = PICTURES["pgm"].replace(b"40 30", b"30000 30000")
    else:
        image = bytearray(PICTURES["tiff"])
        (directory,) = struct.unpack_from("<I", image, 4)
        (count,) = struct.unpack_from("<H", image, directory)
        for place in range(directory + 2, directory + 2 + 12 * count, 12):
            (tag,) = struct.unpack_from("<H", image, place)
            if tag in (256, 257):
                struct.pack_into("<HHII", image, place, tag, 4, 1, size)
        content = bytes(image)
    path = tmp_path / f"labels.{kind}"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"labels\.{kind}: declares 30000 by 30000 pixels"):
        cells_from_label_image(path, 0.002, count=10)
