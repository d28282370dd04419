"""One blurred picture in, the ball's whole path out, as CSV on stdout.

Run:  python examples/03_trajectory.py demo/shot.dng > path.csv
"""

import csv
import sys

import toolkit


def write_path(picture: str) -> None:
    """Measure a shot and write a row for every sample of the path."""
    path = toolkit.measure_shot(toolkit.load_shot(picture)).trajectory
    if path is None:
        sys.exit("no path was measured")
    writer = csv.writer(sys.stdout)
    writer.writerow(["time_s", "x_m", "y_m", "z_m", "x_std_m", "y_std_m", "z_std_m"])
    times = path.time_s or [""] * len(path.position_m)  # no exposure time, no clock
    for time, position, std in zip(times, path.position_m, path.position_std_m, strict=True):
        writer.writerow([time, *position, *std])


if __name__ == "__main__":
    write_path(sys.argv[1])
