"""How far a calibration can be trusted, as plain data for JSON and as lines of text."""

from typing import TYPE_CHECKING, Any

from toolkit.plain_data import to_plain

if TYPE_CHECKING:
    from calibration.intrinsics import Calibration, ModelScore

MAP_COLUMNS, MAP_ROWS = 9, 7
"""Places of the uncertainty map that JSON carries."""


def plain_trust(result: "Calibration") -> dict[str, Any]:
    """Give what says how good a calibration is, ready for JSON."""
    shape = result.board_shape
    return {
        "held_out_px": result.held_out_px,
        "corner_std_px": result.corner_std_px,
        "model_scores": [to_plain(score) for score in result.model_scores],
        "board_bend_squares": None if shape is None else float(shape.max() - shape.min()),
        "board_shape_squares": None if shape is None else shape.tolist(),
        "grid": result.grid.tolist(),
        "tilts": result.tilts,
        "halves": to_plain(result.halves),
        "gates": [to_plain(gate) for gate in result.gates],
        "advice": result.advice_text,
        "more_views": [to_plain(one) for one in result.advice],
        "projection_std_px": to_plain(result.projection_std(MAP_COLUMNS, MAP_ROWS).tolist()),
        "bootstrap_ratio": to_plain(result.bootstrap_ratio),
    }


def score_text(score: "ModelScore") -> str:
    """Describe one lens that was tried."""
    board = "bent" if score.is_bent else "flat"
    return f"{score.model}, {board} board: held-out {score.held_out_px:.3f} px"


def gate_lines(result: "Calibration") -> list[str]:
    """Give the gates' answers but those that only refuse, passed ones first."""
    asked = sorted((g for g in result.gates if not g.is_refusal), key=lambda g: not g.is_passed)
    return [f"{'ok' if gate.is_passed else 'weak'}: {gate.text}" for gate in asked]


def trust_lines(result: "Calibration", square: float | None) -> list[str]:
    """Say which lens was taken, how well it predicts, and which photos would help."""
    taken = next(score for score in result.model_scores if score.is_taken)
    lines = [f"lens {score_text(taken)}; {len(result.model_scores)} compared"]
    if result.board_shape is not None:
        bend = float(result.board_shape.max() - result.board_shape.min())
        size = f"{bend:.3f} squares" if square is None else f"{1000 * bend * square:.2f} mm"
        lines[0] += f"; the board is bent by {size}"
    if result.bootstrap_ratio is not None:
        most = max(result.bootstrap_ratio)
        lines.append(f"bootstrap over views: at most {most:.2f} times the covariance's deviation")
    lines += [line for line in gate_lines(result) if line.startswith("ok")]
    if result.advice:
        lines.append(f"advice: {result.advice_text}")
    return lines
