"""Each case is a wrong file and every line of its report: place, path, what was found, what would be right."""

from pathlib import Path

import pytest

from softplc.config.load import load
from softplc.errors import ConfigError

CASES = Path(__file__).parent / "cases"
NAMES = sorted(file.stem for file in CASES.glob("*.yaml"))


@pytest.mark.parametrize("name", NAMES)
def test_every_error_of_the_file_is_reported_at_its_place(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(CASES)

    with pytest.raises(ConfigError) as raised:
        load(f"{name}.yaml")

    assert Path(f"{name}.expected").read_text(encoding="utf-8").splitlines() == list(raised.value.lines)


def test_the_corpus_holds_what_it_should() -> None:
    assert len(NAMES) >= 130
    assert sorted(file.stem for file in CASES.glob("*.expected")) == NAMES


@pytest.mark.parametrize("name", [name for name in NAMES if "secret" in name or name.startswith("many")])
def test_no_report_shows_a_secret(name: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load(CASES / f"{name}.yaml")

    assert "hunter2" not in str(raised.value)
    assert "12345678" not in str(raised.value)


@pytest.mark.parametrize("name", NAMES)
def test_reports_speak_to_an_engineer(name: str) -> None:
    report = (CASES / f"{name}.expected").read_text(encoding="utf-8")

    for jargon in ("Input should", "validation error", "pydantic", "discriminator", "^[A-Za-z", "NoneType", "dict"):
        assert jargon not in report
