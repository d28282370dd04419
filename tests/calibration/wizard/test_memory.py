from pathlib import Path

import pytest

from calibration.wizard.memory import FILE_NAME, key_of, read_memory
from toolkit.errors import ConfigError

STEPS = ("lens", "ball")


@pytest.fixture
def memory(tmp_path):
    (tmp_path / "camera.toml").write_text("a camera")
    memory = read_memory(tmp_path, STEPS)
    memory.answers["radius"] = ("36 mm",)
    memory.note("lens", "key", outputs=[tmp_path / "camera.toml"], told=['said "so"'])
    return memory


def test_what_was_done_is_known_to_the_next_run(memory, tmp_path):
    again = read_memory(tmp_path, STEPS)
    assert again.answers == {"radius": ("36 mm",)}
    assert again.is_done("lens", "key")
    assert not again.is_done("lens", "other key")
    assert not again.is_done("ball", "key")
    assert again.steps["lens"].told == ('said "so"',)


def test_answers_of_a_step_that_worked_out_take_the_place_of_older_ones(memory, tmp_path):
    memory.keep_answers(["radius", "shot"], {"shot": ("a.dng",), "images": ("not asked",)})
    assert read_memory(tmp_path, STEPS).answers == {"shot": ("a.dng",)}


def test_a_file_that_changed_or_went_is_noticed(memory, tmp_path):
    camera = tmp_path / "camera.toml"
    assert memory.is_own(camera)
    camera.write_text("another camera")
    assert not memory.is_own(camera)
    assert not memory.is_done("lens", "key")
    camera.unlink()
    assert not memory.is_done("lens", "key")


def test_a_step_to_be_done_again_keeps_what_it_owns(memory, tmp_path):
    memory.forget("lens")
    memory.forget("ball")
    assert not memory.is_done("lens", "key")
    assert memory.is_own(tmp_path / "camera.toml")


def test_nothing_new_writes_nothing(memory, tmp_path):
    before = (tmp_path / FILE_NAME).stat().st_mtime_ns
    read_memory(tmp_path, STEPS).save()
    assert (tmp_path / FILE_NAME).stat().st_mtime_ns == before


def test_contents_count_and_names_do_not(tmp_path):
    for name, text in (("a", "x"), ("b", "x"), ("c", "y")):
        (tmp_path / name).write_text(text)
    a, b, c = (tmp_path / name for name in "abc")
    assert key_of({"n": 1}, [a]) == key_of({"n": 1}, [b])
    assert key_of({"n": 1}, [a]) != key_of({"n": 1}, [c])
    assert key_of({"n": 1}, [a]) != key_of({"n": 2}, [a])
    assert key_of({}, [a, c]) != key_of({}, [c, a])
    assert key_of({}, [Path("gone")]) == key_of({}, [tmp_path / "gone"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no toml", "is not valid TOML"),
        ('schema = "toolkit.wizard/2"', "has schema 'toolkit.wizard/2'"),
        ('schema = "toolkit.wizard/1"\n[walls]', "unknown key 'walls'"),
        ('schema = "toolkit.wizard/1"\n[answers]\nradius = 3', "'radius' is no list of texts"),
        ('schema = "toolkit.wizard/1"\n[lens]\noutputs = ["a"]', "is damaged; delete the file"),
        ('schema = "toolkit.wizard/1"\n[lens]\nkey = 3', "'key' is 3; a str is needed"),
    ],
)
def test_a_damaged_file_is_refused_and_left_alone(tmp_path, text, message):
    path = tmp_path / FILE_NAME
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_memory(tmp_path, STEPS)
    assert path.read_text() == text
