"""What is built: an sdist that can be tested and run, and a version that says of which commit it is."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import hatch_build
from accelcal_cli.core import version
from accelcal_cli.core.version import STATED, __version__, build_version

pytest.importorskip("hatchling", reason="hatchling builds what is tested here")
ROOT = Path(__file__).resolve().parent.parent
NOT_SHIPPED = {".ci", ".github", ".gitignore", ".pre-commit-config.yaml"}
COMMIT = hatch_build.git("rev-parse", "--short=7", "HEAD")
NEEDS_GIT = pytest.mark.skipif(not COMMIT, reason="this is not a git checkout")


def built(root: Path, kind: str, out: Path) -> Path:
    """Build an sdist or a wheel of a folder."""
    code = f"from hatchling.build import build_{kind}; print(build_{kind}({str(out)!r}))"
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out / done.stdout.split()[-1]


@NEEDS_GIT
def test_p13_the_sdist_has_what_make_demo_and_make_test_need(tmp_path: Path) -> None:
    with tarfile.open(built(ROOT, "sdist", tmp_path)) as archive:
        archive.extractall(tmp_path / "x", filter="data")
    (folder,) = (tmp_path / "x").iterdir()
    tracked = hatch_build.git("ls-files").splitlines()
    wanted = {
        name for name in tracked if name.partition("/")[0] not in NOT_SHIPPED and (ROOT / name).exists()
    }
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert wanted - there == set()
    assert there - wanted <= {"PKG-INFO", ".gitignore", hatch_build.MADE}
    made = (folder / hatch_build.MADE).read_text().strip()
    assert made == hatch_build.version() and COMMIT in made
    assert f"\nVersion: {made}\n" in (folder / "PKG-INFO").read_text()
    with zipfile.ZipFile(built(folder, "wheel", tmp_path)) as wheel:  # without git
        assert wheel.read(hatch_build.MADE).decode().strip() == made
        assert "accelcal_cli/exports/scripts/run_ggir.R.in" in wheel.namelist()


@NEEDS_GIT
def test_p9_the_version_of_a_checkout_names_its_commit() -> None:
    assert build_version() == __version__ == f"{NEXT}.dev0+g{COMMIT}"
    assert hatch_build.version().startswith(f"{NEXT}.dev") and f"+g{COMMIT}" in hatch_build.version()


def git_folder(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder / "accelcal_cli/core/version.py"


NEXT = STATED.removesuffix(".dev0")
SHA = "9e2152a0123456789012345678901234567890ab"


@pytest.mark.parametrize(
    ("files", "found"),
    [
        ({".git/HEAD": f"{SHA}\n"}, f"{NEXT}.dev0+g9e2152a"),
        ({".git/HEAD": "ref: refs/heads/a/b\n", ".git/refs/heads/a/b": SHA}, f"{NEXT}.dev0+g9e2152a"),
        (
            {".git/HEAD": "ref: refs/heads/main\n", ".git/packed-refs": f"# pack\n{SHA} refs/heads/main\n"},
            f"{NEXT}.dev0+g9e2152a",
        ),
        (
            {
                ".git": "gitdir: real/worktrees/w\n",
                "real/worktrees/w/HEAD": "ref: refs/heads/x\n",
                "real/worktrees/w/commondir": "../..\n",
                "real/refs/heads/x": SHA,
            },
            f"{NEXT}.dev0+g9e2152a",
        ),
        ({".git/HEAD": "ref: refs/heads/none\n"}, STATED),
        ({"accelcal_cli/core/_build.txt": "1.0.0.dev5+g9e2152a\n", ".git/HEAD": SHA}, "1.0.0.dev5+g9e2152a"),
        ({}, STATED),
    ],
)
def test_p9_where_the_commit_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: dict[str, str], found: str
) -> None:
    """No git is run: a repository's files say it, a build's file, or nothing."""
    monkeypatch.setattr(version, "__file__", str(git_folder(tmp_path, files)))
    assert build_version() == found


def test_the_lock_names_exact_versions_of_what_the_project_needs() -> None:
    lines = [line for line in (ROOT / "requirements.lock").read_text().splitlines() if line[0] != "#"]
    names = [line.partition("==")[0] for line in lines]
    assert all("==" in line and "/" not in line and "@" not in line for line in lines)
    assert names == sorted(set(names))
    assert {"numpy", "click", "h5py", "jinja2", "pandas", "pyarrow", "tqdm", "pytest", "hypothesis"} <= set(
        names
    )
