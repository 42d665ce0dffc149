"""Clones to run dev.py in."""

from pathlib import Path

import pytest

from tests.setup.clones import make_clone, make_ready


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone without .venv."""
    return make_clone(tmp_path / "a clone")  # a space: people have them


@pytest.fixture
def ready(clone: Path) -> Path:
    """A clone whose .venv is in order, with a softplc command that says what it got and ends with code 7."""
    return make_ready(clone)


@pytest.fixture
def hidden_ensurepip(tmp_path: Path) -> str:
    """A PYTHONPATH by which ensurepip is not there, as on Debian without python3-venv."""
    folder = tmp_path / "hidden"
    folder.mkdir()
    (folder / "ensurepip.py").write_text("raise ModuleNotFoundError('No module named ensurepip', name='ensurepip')")
    return str(folder)
