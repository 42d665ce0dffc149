"""Third-party peers: npm packages under tests/peers, Debian's mbpoll; tests skip with the reason where missing."""

import os
import shutil
from pathlib import Path

import pytest

PEERS = Path(os.environ.get("SOFTPLC_PEERS", Path(__file__).parent.parent / "peers"))


def need_npm(package: str) -> Path:
    """Folder to run node in so that it finds the package; skips the test when it is not installed."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    if not (PEERS / "node_modules" / package).is_dir():
        pytest.skip(f"npm package {package} is not installed: run npm ci in tests/peers")
    return PEERS


def need_program(name: str) -> str:
    """Path of a program; skips the test when it is not installed."""
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed")
    return path
