"""Moments of inertia that an exporter made up: said, with the link and what to do, and no longer refused."""

import pytest

from invdyn.models import BodyError, load_body

URDF = """<robot name="r"><link name="base"/>
<joint name="j0" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/></joint>
<link name="upper"><inertial><origin xyz=".15 0 0"/><mass value="1.5"/>
  <inertia ixx=".001" iyy=".011" izz=".011" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="upper"/><child link="hand"/><origin xyz=".3 0 0"/><axis xyz="{axis}"/>
</joint>
<link name="hand"><inertial><origin xyz=".02 0 0"/><mass value="{mass}"/>
  <inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="end" type="fixed"><parent link="hand"/><child link="tip"/><origin xyz=".04 0 0"/></joint><link name="tip"/>
</robot>"""


@pytest.mark.parametrize(("axis", "is_chain"), [("0 0 1", True), ("0 1 0", False)])
@pytest.mark.parametrize("mass", [1.0, 1e-4])
def test_a_placeholder_is_said_and_the_body_is_as_the_file_says(tmp_path, axis, is_chain, mass):
    path = tmp_path / "r.urdf"
    path.write_text(URDF.format(axis=axis, mass=mass, moment=1))
    with pytest.warns(UserWarning, match="link 'hand': an inertia of 1 kg·m².*the link reaches 0.04 m: a placeholder"):
        body = load_body(path)
    assert body.is_chain == is_chain
    own = body.parameters().inertia
    assert float(own[1] if is_chain else own[1, 2]) == pytest.approx(1)
    # what is read is written, and read again
    body.to_toml(tmp_path / "r.toml")
    with pytest.warns(UserWarning, match="a placeholder"):
        load_body(tmp_path / "r.toml")


@pytest.mark.parametrize("axis", ["0 0 1", "0 1 0"])
def test_true_moments_go_by_and_those_in_another_unit_do_not(tmp_path, axis):
    path = tmp_path / "r.urdf"
    path.write_text(URDF.format(axis=axis, mass=1.0, moment=2e-4))
    load_body(path)
    path.write_text(URDF.format(axis=axis, mass=1.0, moment=2.3e3))
    with pytest.raises(BodyError, match=r"expected (an inertia|moments) as of mass within"):
        load_body(path)
