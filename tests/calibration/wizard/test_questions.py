from pathlib import Path

import pytest

from calibration.wizard.named_files import find_pictures, split_words
from calibration.wizard.questions import Asker, Question, one_of, optional, yes_or_no
from toolkit.errors import ConfigError


def number(words):
    try:
        return int(words[0])
    except ValueError:
        raise ConfigError(f"'{words[0]}' is no number") from None


COUNT = Question(name="count", flag="--count N", text="How many", parse=number)
DEFAULT = Question(name="more", flag="--more N", text="And more", parse=number, default=("5",))
PICTURES = Question(
    name="images",
    flag="--images F",
    text="Which",
    parse=find_pictures,
    split=split_words,
    is_path=True,
)


class Person:
    def __init__(self, *lines):
        self.lines, self.heard = list(lines), []

    def answer(self, text, default):
        return self.lines.pop(0) or default

    def tell(self, text):
        self.heard.append(text)


def asker(*lines, given=None, answers=None, alone=False, folder=Path()):
    return Asker(
        folder=folder,
        given=given or {},
        answers={} if answers is None else answers,
        person=None if alone else Person(*lines),
    )


def test_a_flag_beats_what_was_answered_before_which_beats_asking():
    both = asker(given={"count": ("1",)}, answers={"count": ("2",)})
    assert both.ask(COUNT) == 1
    assert both.answers == {"count": ("1",)}
    assert asker(answers={"count": ("2",)}).ask(COUNT) == 2
    assert asker("3").ask(COUNT) == 3


def test_a_bad_answer_is_explained_and_asked_again():
    one = asker("many", "", "3")
    assert one.ask(COUNT) == 3
    assert one.person.heard[0] == "! 'many' is no number"
    assert one.person.heard[1].startswith("! an answer is needed; Ctrl-C stops")
    assert one.answers == {"count": ("3",)}


def test_an_empty_line_takes_the_default():
    assert asker("").ask(DEFAULT) == 5
    assert asker(alone=True).ask(DEFAULT) == 5


def test_without_a_person_the_flag_is_named():
    with pytest.raises(ConfigError, match="--count N is missing: How many"):
        asker(alone=True).ask(COUNT)


def test_a_bad_flag_is_an_error_even_with_a_person():
    with pytest.raises(ConfigError, match=r"^--count: 'x' is no number"):
        asker("3", given={"count": ("x",)}).ask(COUNT)


def test_what_did_not_work_out_is_asked_again_with_the_last_answer_as_default():
    one = asker("", "4", given={"count": ("3",)})
    assert one.ask(COUNT) == 3
    one.refuse("count")
    assert not one.knows("count")
    assert one.ask(COUNT) == 3
    one.refuse("count")
    assert one.ask(COUNT) == 4
    assert one.ask(COUNT) == 4


def test_names_of_files_are_kept_as_seen_from_the_folder(tmp_path, monkeypatch):
    (tmp_path / "chess").mkdir()
    (tmp_path / "rig").mkdir()
    (tmp_path / "chess" / "a.jpg").touch()
    monkeypatch.chdir(tmp_path)
    first = asker("chess/*.jpg", folder=Path("rig"))
    assert first.ask(PICTURES) == (Path("chess/a.jpg"),)
    assert first.answers == {"images": ("../chess/*.jpg",)}
    monkeypatch.chdir(tmp_path / "rig")
    again = asker(answers=first.answers, alone=True)
    assert again.ask(PICTURES) == (Path("../chess/a.jpg"),)


def test_a_file_that_has_gone_is_not_sought_elsewhere(tmp_path, monkeypatch):
    """One of the same name lies where the next run happens to start."""
    (tmp_path / "rig").mkdir()
    (tmp_path / "rig" / "a.jpg").touch()
    monkeypatch.chdir(tmp_path / "rig")
    first = asker("a.jpg")
    first.ask(PICTURES)
    assert first.answers == {"images": ("./a.jpg",)}
    (tmp_path / "rig" / "a.jpg").rename(tmp_path / "a.jpg")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"rig/a.jpg does not exist"):
        asker(answers=first.answers, alone=True, folder=Path("rig")).ask(PICTURES)


def test_a_file_that_has_gone_is_asked_for_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("b.jpg").touch()
    one = asker("b.jpg", answers={"images": ("gone.jpg",)})
    assert one.ask(PICTURES) == (Path("b.jpg"),)
    assert "gone.jpg does not exist" in one.person.heard[0]
    with pytest.raises(ConfigError, match=r"^--images: gone.jpg does not exist"):
        asker(answers={"images": ("gone.jpg",)}, alone=True).ask(PICTURES)


def test_words():
    assert yes_or_no(("Y",))
    assert not yes_or_no(("no",))
    with pytest.raises(ConfigError, match="'maybe' is neither yes nor no"):
        yes_or_no(("maybe",))
    assert optional(int)(("none",)) is None
    assert optional(int)(("3",)) == 3
    pick = one_of("plain", "two-colour", "two-tone")
    assert pick(("P",)) == "plain"
    assert pick(("two-colour",)) == "two-colour"
    for text in ("two", "", "x"):
        with pytest.raises(ConfigError, match="is none of plain, two-colour, two-tone"):
            pick((text,))
