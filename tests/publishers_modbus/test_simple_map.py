"""Where the tags of the baselines and of cv_accel lie in an axis' block."""

import pytest

from softplc.observers.axes import AxisSpec, axis_tags
from softplc.publishers.modbus.layout import layout
from softplc.scan import task_tags
from softplc.tags import TagTable
from tests.observers.simple import CASES, NAMES, Case

_OFFSETS = {
    "finite_difference": "",
    "moving_average": "window 32",
    "derivative nominal": "cycle 32",
    "alpha_beta fixed": "Innovation 6 K0 10 K1 12 alpha 32 beta 34",
    "alpha_beta indexed": "Innovation 6 S 8 K0 10 K1 12 NIS 20 sigma_w 32 sigma_v 34",
    "one_euro": "Cutoff 26 min_cutoff 32 cutoff_slope 34 d_cutoff 36",
    "cv_accel per scan": "Innovation 6 S 8 K0 10 K1 12 P00 14 P01 16 P11 18 NIS 20 Acceleration 26  q_x 32 \
        q_x_dot 34 r_x 36 q_x_ddot 38",
    "cv_accel white jerk": "Innovation 6 S 8 K0 10 K1 12 P00 14 P01 16 P11 18 NIS 20 Acceleration 26  \
        q_jerk 32 r_x 36",
}
_ALWAYS = (
    "Position 0 Velocity 2 Raw 4 Dt 22 Age 24 Quality 42 Reason 43 Enabled 44 Enable 45 AgeMs 47 Status 48 State 63"
)


@pytest.mark.parametrize("case", [case for case in CASES if case.name in _OFFSETS], ids=lambda case: case.name)
def test_every_tag_has_its_fixed_place(case: Case):
    table = TagTable()
    table.add_block("main", "task", task_tags("main"))
    table.add_block("A", "axis", axis_tags(AxisSpec("A", unit="mm"), case.configs[0]))
    table.close_section("main")

    rows = {row.name: row.address for row in layout(table).rows if row.name.startswith("A.")}

    words = f"{_ALWAYS} {_OFFSETS[case.name]}".split()
    assert rows == {f"A.{leaf}": 3000 + int(at) for leaf, at in zip(words[::2], words[1::2], strict=True)}


def test_every_kind_of_tag_is_covered():
    assert set(_OFFSETS) <= set(NAMES)
    leaves = {leaf for case in CASES for leaf in (*case.configs[0].estimates, *case.configs[0].tuning)}
    assert leaves - {"K2", "P02", "P12", "P22"} <= set(" ".join(_OFFSETS.values()).split())
