"""What every study hands over, and how it becomes files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from softplc.commissioning.report import Report, page
from softplc.errors import SoftplcError


@dataclass(frozen=True, slots=True)
class Study:
    """A finished study: `numbers` are what its report rests on, ready for JSON."""

    name: str
    report: Report
    numbers: dict[str, Any]

    def reproduced(self) -> bool:
        """Whether every claim holds."""
        return all(claim.holds for claim in self.report.claims)


def expect_folder(folder: Path) -> None:
    """Raises SoftplcError where this cannot become a folder, before anybody waits for a study."""
    if folder.exists() and not folder.is_dir():
        raise SoftplcError(f"{folder}: is a file; --output names a folder")


def save(study: Study, folder: Path) -> list[Path]:
    """Write the report and its pictures into the folder, which is made where it is missing; returns the files.

    Files of the same name are replaced, others are left alone. Raises SoftplcError when that cannot be done.
    """
    files = {folder / f"{picture.name}.png": picture.png for picture in study.report.pictures()}
    files = {folder / "report.html": page(study.report).encode(), **files}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path, content in files.items():
            path.write_bytes(content)
    except OSError as error:
        raise SoftplcError(f"{folder}: cannot write: {error.strerror}") from error
    return list(files)
