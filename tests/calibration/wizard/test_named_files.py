from pathlib import Path

import pytest

from calibration.wizard.named_files import find_file, find_pictures, split_words
from toolkit.errors import ConfigError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my chess").mkdir()
    for name in ("b.JPG", "a.jpg", "notes.txt", "a[1].jpg"):
        (tmp_path / "my chess" / name).touch()
    return tmp_path


@pytest.mark.parametrize("line", ["my chess", "'my chess'", '"my chess"', "my\\ chess"])
def test_a_folder_stands_for_its_pictures(folder, line):
    found = find_pictures(split_words(line))
    assert [path.name for path in found] == ["a.jpg", "a[1].jpg", "b.JPG"]


def test_patterns_and_names_that_look_like_one(folder):
    assert find_pictures(split_words("'my chess/a*.jpg'")) == (
        Path("my chess/a.jpg"),
        Path("my chess/a[1].jpg"),
    )
    assert find_pictures(["my chess/a[1].jpg"]) == (Path("my chess/a[1].jpg"),)


def test_a_name_given_twice_counts_once(folder):
    assert len(find_pictures(["my chess/a.jpg", "my chess/a*.jpg"])) == 2


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("my chess/c.JPG", "my chess/c.JPG does not exist; did you mean my chess/b.JPG?"),
        ("ches/a.jpg", "there is no folder ches; you are in "),
        ("my chess/*.png", "no file matches; .*my chess holds a.jpg"),
        ("nothing", "nothing does not exist; .* holds my chess"),
    ],
)
def test_a_wrong_path_is_answered_with_what_is_there(folder, word, message):
    with pytest.raises(ConfigError, match=message):
        find_pictures([word])


def test_a_folder_without_pictures_and_an_empty_answer(folder):
    (folder / "empty").mkdir()
    with pytest.raises(ConfigError, match=r"empty holds no pictures; .*empty is empty"):
        find_pictures(["empty"])
    with pytest.raises(ConfigError, match="no picture was named"):
        find_pictures([])


def test_one_file_is_one_file(folder):
    assert find_file(["my chess/notes.txt"]) == Path("my chess/notes.txt")
    with pytest.raises(ConfigError, match="2 files were named"):
        find_file(["a", "b"])
    with pytest.raises(ConfigError, match="is a folder; name a file in it"):
        find_file(["my chess"])
    with pytest.raises(ConfigError, match="does not exist"):
        find_file(["my chess/zzzzzz"])


def test_an_apostrophe_is_no_quote(folder):
    assert split_words("coach's chess") == ("coach's", "chess")
