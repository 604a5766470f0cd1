"""The how-to pages show what exists: names, options, settings, files."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.main import get_command

import pv_inspect
from pv_inspect.calibration.camera_file import read_camera
from pv_inspect.calibration.camera_profile import read_profile
from pv_inspect.cli.app import app
from pv_inspect.evaluation.peers.own_model import OwnModel
from pv_inspect.settings import Settings

PAGES = sorted((Path(__file__).parents[1] / "docs" / "how-to").glob("*.md"))


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)


def of_all_pages(language: str) -> list[str]:
    return [block for page in PAGES for block in blocks(page, language)]


def commands() -> list[list[str]]:
    lines = "\n".join(of_all_pages("sh")).splitlines()
    lines += re.findall(r"`(pv-inspect [^`]+)`", "\n".join(p.read_text("utf-8") for p in PAGES))
    return [shlex.split(line.split("||")[0]) for line in lines if "pv-inspect" in line]


def test_python_compiles_and_names_what_the_public_face_has() -> None:
    snippets = of_all_pages("python")
    assert len(snippets) >= 3
    for snippet in snippets:
        compile(snippet, "how-to", "exec")
        assert set(re.findall(r"\bpv\.(\w+)", snippet)) <= set(pv_inspect.__all__)


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_a_command_has_the_options_that_are_shown(words: list[str]) -> None:
    group: Any = get_command(app)
    assert words[0] == "pv-inspect"
    command = group.get_command(typer.Context(group), words[1])
    assert command is not None
    known = {name for option in command.params for name in (*option.opts, *option.secondary_opts)}
    assert {word for word in words if re.match("--?[a-z]", word)} <= known


def test_options_in_the_text_exist() -> None:
    group: Any = get_command(app)
    context = typer.Context(group)
    known = {
        name
        for command in group.list_commands(context)
        for option in group.get_command(context, command).params
        for name in (*option.opts, *option.secondary_opts)
    }
    text = "\n".join(page.read_text("utf-8") for page in PAGES)
    assert set(re.findall(r"`(--[a-z][a-z-]+)", text)) <= known


def test_the_settings_file_is_read(tmp_path: Path) -> None:
    others = ("[lens]", "value_range")
    (text,) = [b for b in of_all_pages("toml") if not any(word in b for word in others)]
    (tmp_path / "plant.toml").write_text(text)
    assert Settings.from_toml(tmp_path / "plant.toml").cell_width_mm == 156.75


def test_the_camera_profile_is_read(tmp_path: Path) -> None:
    (text,) = [block for block in of_all_pages("toml") if "[lens]" in block]
    (tmp_path / "camera.toml").write_text(text)
    profile = read_profile(tmp_path / "camera.toml", (512, 640))
    assert profile.sigma is not None
    assert profile.sigma.value == 0.512


def test_the_calibration_is_read(tmp_path: Path) -> None:
    (text,) = [block for block in of_all_pages("json") if "camera_matrix" in block]
    (tmp_path / "camera.json").write_text(text)
    camera = read_camera(tmp_path / "camera.json", (512, 640))
    assert camera.kappa == json.loads(text)["distortion_coefficients"][0]


def test_the_description_of_a_network_is_read(tmp_path: Path) -> None:
    (text,) = [block for block in of_all_pages("toml") if "value_range" in block]
    (tmp_path / "mine.toml").write_text(text)
    (tmp_path / "mine.onnx").write_bytes(b"any")
    assert OwnModel.read(tmp_path / "mine.onnx", []).declared.scale == 4
