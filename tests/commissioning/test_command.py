"""The study commands at their edges."""

import subprocess
import sys

from tests.support.program import ROOT, environment, softplc


def test_the_studies_are_listed_and_explain_themselves():
    listing = softplc("study", "--help")
    assert listing.returncode == 0
    for name in ("aoi", "ducekf"):
        assert name in listing.stdout
        done = softplc("study", name, "--help")
        assert done.returncode == 0
        assert "--output" in done.stdout
        assert "--json" in done.stdout


def test_without_matplotlib_the_error_says_what_to_install_and_exits_1(tmp_path):
    code = (
        "import sys; sys.modules['matplotlib'] = None; sys.argv = ['softplc', 'study', 'aoi'];"
        "from softplc.cli import main; sys.exit(main())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert done.stdout == ""
    assert 'pip install "softplc[study]"' in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_named_and_exits_1(tmp_path):
    place = tmp_path / "file"
    place.write_text("mine")
    done = softplc("study", "aoi", "--output", str(place))
    assert done.returncode == 1
    assert str(place) in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert place.read_text() == "mine"


def test_matplotlib_is_not_imported_by_other_commands():
    done = softplc("study", "--help", PYTHONPROFILEIMPORTTIME="1")
    assert " matplotlib\n" not in done.stderr
    assert " numpy\n" not in done.stderr


def test_the_extra_that_the_error_names_is_there():
    assert 'study = ["matplotlib' in (ROOT / "pyproject.toml").read_text()
