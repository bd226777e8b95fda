"""Links of URDF and SDF files, and convex decompositions with gaps, become one footprint."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from shapely.geometry import box

from slipmap.models.objects import cells_from_mesh
from slipmap.models.objects.meshes import upright_mesh

URDF = """<robot name="hammer"><link name="hammer">
<visual><origin xyz="0 0.1 0.02" rpy="0 0 {turn}"/>
<geometry><mesh filename="{mesh}" scale="0.001 0.001 0.001"/></geometry></visual>
<visual><origin xyz="0 0 0.02"/><geometry><box size="0.02 0.2 0.04"/></geometry></visual>
<collision><geometry><sphere radius="9"/></geometry></collision></link>{more}</robot>"""
SDF = """<sdf version="1.9"><model name="hammer"><link name="hammer">
<visual name="head"><pose>0 0.1 0.02 0 0 0</pose><geometry><mesh><uri>{mesh}</uri>
<scale>0.001 0.001 0.001</scale></mesh></geometry></visual>
<collision name="grip"><geometry><box><size>9 9 9</size></box></geometry></collision>
<visual name="grip"><pose>0 0 0.02 0 0 0</pose>
<geometry><box><size>0.02 0.2 0.04</size></box></geometry></visual>
</link>{more}</model></sdf>"""


@pytest.fixture
def package(tmp_path):
    """A package with a head of 80 by 30 by 40 mm, as STL in mm."""
    root = tmp_path / "tools"
    for folder in ("meshes", "urdf"):
        (root / folder).mkdir(parents=True)
    (root / "package.xml").write_text("<package/>")
    trimesh.creation.box((80, 30, 40)).export(root / "meshes" / "head.stl")
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "outside.stl")
    return root


def written(package, text, name, **places):
    path = package / "urdf" / name
    path.write_text(text.format(**({"turn": 0, "more": ""} | places)))
    return path


@pytest.mark.parametrize("mesh", ["package://tools/meshes/head.stl", "model://tools/meshes/head.stl",
                                  "../meshes/head.stl"])  # fmt: skip
@pytest.mark.parametrize(("text", "name"), [(URDF, "a.urdf"), (SDF, "a.sdf")])
def test_a_link_is_an_object(package, text, name, mesh):
    path = written(package, text, name, mesh=mesh)
    grid = cells_from_mesh(path, count=40)
    expected = box(-0.01, -0.1, 0.01, 0.1).union(box(-0.04, 0.085, 0.04, 0.115))
    assert grid.polygon.symmetric_difference(expected).area < 1e-9
    assert upright_mesh(path).extents[2] == pytest.approx(0.04)


def test_parts_are_turned_about_fixed_axes(package):
    path = written(package, URDF, "a.urdf", mesh="../meshes/head.stl", turn=0.5 * np.pi)
    x, y = np.ptp(cells_from_mesh(path, count=40).exterior, axis=0)
    assert (x, y) == pytest.approx((0.03, 0.24), abs=1e-9)


@pytest.mark.parametrize(
    ("places", "message"),
    [
        ({"mesh": "../../outside.stl"}, "is not in the file's folder or package"),
        ({"mesh": "/etc/passwd"}, "is not in the file's folder or package"),
        ({"mesh": "package://tools/../outside.stl"}, "is not in the file's folder or package"),
        ({"mesh": "package://other/head.stl"}, "is not in the file's folder or package"),
        ({"mesh": "package:///etc/passwd"}, "is not in the file's folder or package"),
        ({"mesh": "file:///etc/head.stl"}, "is not in the file's folder or package"),
        ({"mesh": "../meshes/none.stl"}, "no such file"),
        ({"mesh": "../meshes/circle.stl"}, "no such file"),
        ({"mesh": "a.urdf"}, "is no mesh"),
        ({"mesh": "../meshes/head.stl", "turn": "nan"}, "rpy needs 3 numbers"),
        ({"mesh": "x", "more": "<link name='b'><visual><geometry/></visual></link>"}, "found hammer, b"),
        ({"mesh": "x", "more": "<"}, "is not XML"),
    ],
)
def test_links_that_are_refused(package, places, message):
    (package / "meshes" / "circle.stl").symlink_to("circle.stl")
    with pytest.raises(ValueError, match=message):
        cells_from_mesh(written(package, URDF, "a.urdf", **places), count=40)


@pytest.mark.parametrize("text", ["<pose/>", "<pose> </pose>", "<submesh><name>a</name></submesh>"])
def test_an_empty_pose_is_none_and_a_submesh_is_refused(package, text):
    pose = "pose" in text
    mesh = f"<mesh><uri>../meshes/head.stl</uri>{'' if pose else text}</mesh>"
    shape = f"<visual name='a'>{text if pose else ''}<geometry>{mesh}</geometry></visual>"
    path = written(package, f"<sdf><model><link name='a'>{shape}</link></model></sdf>", "a.sdf")
    if pose:
        assert upright_mesh(path, metres_per_unit=0.001).extents == pytest.approx([0.08, 0.03, 0.04])
    else:
        with pytest.raises(ValueError, match="a submesh is not read"):
            upright_mesh(path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_entities_do_not_explode(package, encoding):
    laughs = '<!DOCTYPE a [<!ENTITY b "ha"><!ENTITY c "&b;&b;&b;&b;">]><robot>&c;</robot>'
    with pytest.raises(ValueError, match="never expanded"):
        path = package / "a.urdf"
        path.write_text(laughs, encoding=encoding)
        cells_from_mesh(path, count=40)


def test_gaps_of_a_decomposition_are_closed(tmp_path):
    """A hammer in three convex parts, 2 mm apart."""
    parts = [
        trimesh.creation.box(bounds=[low, high])
        for low, high in (
            ([-0.01, -0.1, 0], [0.01, 0.083, 0.03]),
            ([-0.04, 0.085, 0], [-0.001, 0.115, 0.03]),
            ([0.001, 0.085, 0], [0.04, 0.115, 0.03]),
        )
    ]
    trimesh.util.concatenate(parts).export(tmp_path / "parts.obj")
    with pytest.warns(UserWarning, match="between 3 parts closed"):
        outline = cells_from_mesh(tmp_path / "parts.obj", count=60).polygon
    whole = box(-0.01, -0.1, 0.01, 0.085).union(box(-0.04, 0.085, 0.04, 0.115))
    assert outline.symmetric_difference(whole).area < 0.02 * whole.area
    assert_allclose(outline.bounds, whole.bounds, atol=1e-6)
    parts[2].apply_translation([0.01, 0, 0])
    trimesh.util.concatenate(parts).export(tmp_path / "apart.obj")
    with pytest.raises(ValueError, match="3 separate parts"):
        cells_from_mesh(tmp_path / "apart.obj", count=60)


def test_many_specks_are_refused_with_a_few_of_them():
    specks = trimesh.creation.box((1e-3, 1e-3, 1e-3))
    many = [specks.copy().apply_translation([2e-3 * k, 0, 0]) for k in range(201)]
    with pytest.raises(ValueError, match=r"201 separate parts \(.*?(\[[^\]]*\], ){5}…\)"):
        cells_from_mesh(trimesh.util.concatenate(many), count=40)
