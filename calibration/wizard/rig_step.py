"""Write what the steps found out into rig.toml, beside what somebody else wrote there."""

from glob import escape
from pathlib import Path
from typing import Any

from calibration.wizard.ball_step import (
    BALL_NAME,
    RADIUS,
    RADIUS_STD,
    estimator_of,
    has_looks,
)
from calibration.wizard.desk import Desk, Outcome
from calibration.wizard.lens import camera_path
from calibration.wizard.light import response_of
from calibration.wizard.memory import key_of
from calibration.wizard.scene import BACKGROUND, EXPOSURE, READOUT
from toolkit.files import read_toml, write_text
from toolkit.rig import read_rig
from toolkit.toml_text import to_toml

STEP = "rig"
RIG_NAME = "rig.toml"

Table = dict[str, Any]


def write_rig(desk: Desk) -> Outcome:
    """Bring rig.toml up to what was answered; keys that the wizard does not ask for stay.

    Raises:
        ConfigError: when the rig.toml that is there is damaged, or somebody else's.
    """
    path = rig_path(desk)
    before = _present(path)
    table = {name: dict(section) for name, section in before.items()}
    for name, section in _sections(desk).items():
        _merge(table, name, section)
    key = key_of({"rig": to_toml("rig", table)})
    if table == before and desk.memory.is_done(STEP, key):
        return desk.kept(STEP)
    if table != before:  # else its comments stay too
        desk.check_writable(path)
        write_text(path, to_toml("rig", table))
    return desk.done(STEP, key, told=[f"wrote {path}"], outputs=(path,))


def rig_path(desk: Desk) -> Path:
    """Give the place of the rig."""
    return desk.folder / RIG_NAME


def _present(path: Path) -> Table:
    """Give the tables of the rig.toml that is there, checked; empty where there is none."""
    if not path.exists():
        return {}
    read_rig(path)
    return {name: dict(section) for name, section in read_toml(path, "rig").items()}


def _sections(desk: Desk) -> dict[str, Table]:
    """Give what was answered, by section; None takes a key out."""
    name_of, asker = desk.memory.name_of, desk.asker
    response = response_of(desk)
    is_file = response is not None and Path(response).is_file()
    ball: Table = {"radius_m": desk.ask(RADIUS), "radius_std_m": desk.ask(RADIUS_STD)}
    if has_looks(desk):
        ball |= {"file": BALL_NAME, "colours": None}
    exposure: Table = {}
    if asker.knows(EXPOSURE.name):
        exposure["time_s"] = desk.ask(EXPOSURE)
    if asker.knows(READOUT.name):
        exposure["readout_s"] = desk.ask(READOUT) or None
    estimator = estimator_of(desk)
    return {
        "camera": {"file": name_of(camera_path(desk))},
        "response": {
            "file": name_of(Path(response)) if response is not None and is_file else None,
            "kind": None if is_file else response,
        },
        "ball": ball,
        "exposure": exposure,
        "background": {"images": [escape(name_of(p)) for p in desk.ask(BACKGROUND)]},
        "measure": {} if estimator is None else {"estimator": estimator},
    }


def _merge(table: Table, name: str, section: Table) -> None:
    """Set the keys of a section; those that are None go, and so does an empty section."""
    merged = {**table.pop(name, {}), **section}
    known = {key: value for key, value in merged.items() if value is not None}
    if known:
        table[name] = known
