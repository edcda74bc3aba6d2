"""`[detector]` in a configuration, in `camtopod check`, `check --probe` and `grab`."""

from __future__ import annotations

from pathlib import Path

import cv2
import msgspec
import pytest
from coloured_scenes import FACTOR, ColouredScene
from onnx_models import write_model
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, line

from camtopod.cli.main import main
from camtopod.config.config_file import parse
from camtopod.config.settings import Config, ConfigError
from camtopod.vision.settings import DetectorSettings

BUS = '[bus]\nconnect = ["tcp/127.0.0.1:9"]\nconnect_seconds = 0.1\n'


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Somebody in the models' colours, from the first picture on."""
    path = tmp_path_factory.mktemp("film") / "hall.mp4"
    scene = ColouredScene([Person(line(0.0, (0.2, 0.9), (1.05, 0.9), 5.0), tall=0.6)])
    size = (WIDTH * FACTOR, HEIGHT * FACTOR)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), FPS, size)
    for k in range(round(5 * FPS)):
        writer.write(scene.picture(k / FPS))
    writer.release()
    return path


def write(folder: Path, text: str) -> Path:
    path = folder / "c.toml"
    path.write_text(text)
    return path


# --- settings -------------------------------------------------------------------------------------


def test_a_camera_has_the_common_detector_one_of_its_own_or_none() -> None:
    config = parse(
        '[detector]\nmodel = "a.onnx"\nscore = 0.5\n'
        "[cameras.plain]\n[cameras.off]\ndetector = false\n"
        '[cameras.own.detector]\nmodel = "b.onnx"\nlabels = ["person", 3]\n'
        "[cameras.inline]\ndetector = { looks_per_second_max = 2.0 }\n"
    )
    common = DetectorSettings("a.onnx", score=0.5)
    of = {name: camera.detector for name, camera in config.cameras.items()}
    assert config.detector == of["plain"] == common
    assert of["off"] == DetectorSettings()
    assert of["own"] == DetectorSettings("b.onnx", ("person", 3), 0.5)
    assert of["inline"] == msgspec.structs.replace(common, looks_per_second_max=2.0)
    assert config.for_camera("new", "0").cameras["new"].detector == common
    assert Config().detector.model == ""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[detector]\nscore = 0.5\n", ":1: detector: model is missing"),
        ('[detector]\nmodel = "a"\nscore = 2\n', ":3: detector.score: expected a number <= 1.0"),
        (
            '[detector]\nmodel = "a"\nlabels = [\n"person",\n"persn"]\n',
            ":3: detector.labels: COCO has no 'persn'; did you mean 'person'?",
        ),
        ('[detector]\nmodel = "a"\nlabels = []\n', ":3: detector.labels: is empty"),
        (
            '[detector]\nmodel = "a"\nlayout = "yolo"\n',
            ":3: detector.layout: expected one of yolox, yolov8, ",
        ),
        (
            "[cameras.a]\ndetector = true\n",
            ":2: cameras.a.detector: expected a table [cameras.a.detector]",
        ),
        ("[cameras.a.detector]\nscore = 0.5\n", ":1: cameras.a.detector: model is missing"),
    ],
)
def test_a_mistake_has_its_line(text: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse(text, "c.toml")
    assert f"c.toml{said}" in str(caught.value)
    assert len(caught.value.problems) == 1


# --- check ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("content", [None, b"nothing of the kind"])
def test_a_model_that_cannot_be_read_is_78_with_its_line(
    tmp_path: Path, film: Path, capsys: pytest.CaptureFixture[str], content: bytes | None
) -> None:
    model = tmp_path / "person.onnx"
    if content is not None:
        model.write_bytes(content)
    path = write(
        tmp_path,
        f'[cameras.a]\nsource = "{film}"\n\n[detector]\nmodel = "person.onnx"\n'
        '[cameras.b]\ndetector = false\n[cameras.c.detector]\nmodel = "other.onnx"\n',
    )
    why = f"cannot read {model}: No such file" if content is None else f"{model} is not an ONNX"

    assert main(["check", str(path)]) == 78
    said = capsys.readouterr().err
    assert f"{path}:5: detector.model: {why}" in said
    assert f"{path}:9: cameras.c.detector.model: cannot read {tmp_path / 'other.onnx'}" in said

    out = str(tmp_path / "out")
    assert main(["--config", str(path), "grab", "--camera", "a", "--out", out]) == 78
    assert f"{path}:5: detector.model: {why}" in capsys.readouterr().err
    assert main(["--config", str(path), "grab", "--camera", "b", str(film), "--out", out]) == 0


def test_a_model_that_opencv_crashes_on_is_78_with_its_line(
    tmp_path: Path,
    film: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is tried in a process of its own."""
    (tmp_path / "onnxruntime.py").write_text("raise ImportError")
    monkeypatch.syspath_prepend(tmp_path)
    model = write_model(tmp_path / "person.onnx", "yolox")
    content = bytearray(model.read_bytes())
    content[content.index(b"Conv")] ^= 0x80
    model.write_bytes(content)
    path = write(tmp_path, f'[cameras.a]\nsource = "{film}"\n[detector]\nmodel = "{model}"\n')
    grab = ["grab", "--camera", "a", "--out", str(tmp_path / "out")]
    for command in (["check", str(path)], ["--config", str(path), *grab]):
        assert main(command) == 78
        assert f"{path}:4: detector.model: cannot run {model}: " in capsys.readouterr().err


def test_a_model_that_fails_on_some_pictures_is_said_in_words(
    tmp_path: Path, film: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On bright ones, so not on the empty one with which it is tried before the camera is."""
    pytest.importorskip("onnxruntime", reason="needs onnxruntime (camtopod[detector])")
    model = write_model(tmp_path / "person.onnx", "yolox", fails_above=200)
    path = write(tmp_path, f'{BUS}[cameras.a]\nsource = "{film}"\n[detector]\nmodel = "{model}"\n')
    fault = f"{model} can be run by onnxruntime no longer: "

    out = str(tmp_path / "out")
    assert main(["--config", str(path), "grab", "--camera", "a", "--out", out]) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"camera a: its detector fails: {fault}" in said
    assert said.endswith("detector = false in [cameras.a] does without one")

    assert main(["check", str(path), "--probe"]) == 78
    assert f"{path}:7: detector.model: {fault}" in capsys.readouterr().err


# --- grab -----------------------------------------------------------------------------------------


def test_grab_uses_the_detector_of_the_camera(
    tmp_path: Path, film: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from camtopod.vision.detector import model as package

    loaded = []

    class Noted(package.DetectorModel):
        def __init__(self, settings: DetectorSettings) -> None:
            loaded.append(settings)
            super().__init__(settings)

    monkeypatch.setattr(package, "DetectorModel", Noted)
    write_model(tmp_path / "person.onnx", "yolox")
    path = write(
        tmp_path,
        '[detector]\nmodel = "person.onnx"\n[cameras.b]\ndetector = false\n'
        "[cameras.c.detector]\nscore = 0.7\n",
    )
    for camera in "abc":
        out = str(tmp_path / camera)
        assert (
            main(["--config", str(path), "grab", "--camera", camera, str(film), "--out", out]) == 0
        )
    assert [settings.score for settings in loaded] == [0.4, 0.7]
