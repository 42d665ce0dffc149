import re
from pathlib import Path

from softplc.kernel.diagnosis import DIAGNOSIS_TEXT, Diagnosis
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec, axis_tags
from softplc.observers.ducekf import DucekfConfig, EndStops
from softplc.sample import Reason
from softplc.scan import source_tags, task_tags

PAGE = (Path(__file__).parents[2] / "docs" / "tags.md").read_text(encoding="utf-8")


def test_every_published_tag_stands_on_the_page_of_tags():
    spec = AxisSpec("X", consistency=(200, 5), shadow=("position", "velocity"), dead_time=0.0)
    stops = DucekfConfig(type="ducekf", r_x=1.0, model=EndStops(type="end_stops", lower=0.0, upper=1.0))
    observers = [AoiConfig(type="aoi", r_x=1.0), stops]
    tags = [tag for observer in observers for tag in axis_tags(spec, observer)]
    tags += [*task_tags("T"), *source_tags("S", heartbeat=True, skew=True)]
    named = set(re.findall(r"`([A-Za-z0-9_]+)`", PAGE))
    assert {tag.name.rpartition(".")[2] for tag in tags} <= named


def test_every_reason_stands_on_the_page_of_tags_with_its_number():
    missing = [reason for reason in Reason if reason and f"{reason.value} {reason.name}" not in PAGE]
    assert set(missing) <= {Reason.DT_INVALID}  # only where an observer starts without a usable step: observers.md


def test_every_number_of_the_lamp_stands_on_the_page_of_tags_with_its_meaning():
    rows = [f"| {code.value} | {DIAGNOSIS_TEXT[code].partition(':')[0]} |" for code in Diagnosis]
    assert [row for row in rows if row not in PAGE] == []
