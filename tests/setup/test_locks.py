"""The locks: every package pinned by hash, no address, everything that pyproject.toml asks for."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
EVERYTHING, RUNTIME = ROOT / "requirements.lock", ROOT / "docker" / "requirements.lock"
PYTHONS = ("3.11.2", "3.12.1", "3.13.0")


def entries(lock: Path) -> list[tuple[Requirement, list[str]]]:
    """Every pinned package with its hashes; fails on a line that is neither, nor a comment."""
    found: list[tuple[Requirement, list[str]]] = []
    for line in lock.read_text().splitlines():
        text = line.removesuffix("\\").strip()
        if text.startswith("--hash="):
            found[-1][1].append(text.removeprefix("--hash="))
        elif text and not text.startswith("#"):
            found.append((Requirement(text), []))
    return found


def pins(lock: Path, python: str) -> dict[str, str]:
    """Name to version of what this Python gets on Linux."""
    environment = {
        "python_full_version": python,
        "python_version": ".".join(python.split(".")[:2]),
        "sys_platform": "linux",
        "platform_python_implementation": "CPython",
        "implementation_name": "cpython",
    }
    chosen = [req for req, _ in entries(lock) if req.marker is None or req.marker.evaluate(environment)]
    names = [canonicalize_name(req.name) for req in chosen]
    assert len(names) == len(set(names))
    return {name: str(req.specifier).removeprefix("==") for name, req in zip(names, chosen, strict=True)}


@pytest.mark.parametrize("lock", [EVERYTHING, RUNTIME], ids=["everything", "runtime"])
def test_lock_pins_every_package_by_hash_and_holds_no_address(lock: Path):
    assert "://" not in lock.read_text()
    assert "index-url" not in lock.read_text()
    for requirement, hashes in entries(lock):
        assert re.fullmatch(r"==[^=*,]+", str(requirement.specifier)), requirement
        assert hashes, requirement
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", digest) for digest in hashes)


@pytest.mark.parametrize("python", PYTHONS)
def test_lock_holds_what_softplc_its_development_and_its_build_ask_for(python: str):
    asked = [
        *PROJECT["project"]["dependencies"],
        *PROJECT["dependency-groups"]["dev"],
        *PROJECT["build-system"]["requires"],
    ]
    pinned = pins(EVERYTHING, python)
    for requirement in map(Requirement, asked):
        assert requirement.specifier.contains(pinned[canonicalize_name(requirement.name)]), requirement


@pytest.mark.parametrize("python", PYTHONS)
def test_runtime_lock_is_the_runtime_part_of_the_lock_and_nothing_of_development(python: str):
    asked = [*PROJECT["project"]["dependencies"], *PROJECT["project"]["optional-dependencies"]["serial"]]
    everything, runtime = pins(EVERYTHING, python), pins(RUNTIME, python)

    assert runtime.items() <= everything.items()
    assert {canonicalize_name(Requirement(text).name) for text in asked} <= runtime.keys()
    assert not {"pytest", "hypothesis", "scipy", "matplotlib", "filterpy", "uv", "hatchling"} & runtime.keys()


def test_lock_that_uv_resolved_with_its_addresses_is_ignored_by_git():
    assert "uv.lock" in (ROOT / ".gitignore").read_text().splitlines()


def test_npm_lock_of_the_peers_pins_by_integrity_and_holds_no_address():
    text = (ROOT / "tests" / "peers" / "package-lock.json").read_text()

    assert '"resolved"' not in text
    assert text.count('"integrity": "sha512-') == text.count('"version":')
