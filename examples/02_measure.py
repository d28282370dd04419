"""One blurred picture in, the ball's position and speed out.

Run:  python examples/02_measure.py demo/shot.dng      (a rig.toml lies in its folder)
"""

import sys

import toolkit


def measure(path: str) -> None:
    """Read a shot with its rig, measure it, and print the state at mid-exposure."""
    shot = toolkit.load_shot(path)
    ball = toolkit.measure_shot(shot)
    print("position m  ", ball.position_m, "+/-", ball.position_std_m)
    print("direction   ", ball.direction)
    print("speed m/s   ", ball.speed_m_s, "+/-", ball.speed_std_m_s)
    if ball.sign is not None and ball.sign.ambiguous:
        print("or the same path the other way round: one picture cannot tell")
    for caution in ball.warnings:
        print("caution:", caution.message)


if __name__ == "__main__":
    measure(sys.argv[1])
