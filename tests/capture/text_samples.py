"""Small captures in every text format, written from the formats' public descriptions."""

import json
from pathlib import Path

import numpy as np

from tests.c3d_write import write_c3d

NAMES = ("brow_L", "brow_R", "lip_U", "chin")
FRAMES = 12
SHAPES = ("EyeBlinkLeft", "JawOpen", "TongueOut")
ROTATIONS = ("HeadYaw", "HeadPitch", "HeadRoll")


def positions() -> np.ndarray:
    """Positions of `NAMES` over `FRAMES` in mm, rounded as the samples write them."""
    return np.random.default_rng(0).normal(0, 100, (FRAMES, len(NAMES), 3)).round(3)


def weights() -> np.ndarray:
    """Weights of `SHAPES` and `ROTATIONS` over `FRAMES`."""
    count = len(SHAPES) + len(ROTATIONS)
    return np.random.default_rng(1).random((FRAMES, count)).round(6)


def _rows(values: np.ndarray, delimiter: str = ",") -> list[str]:
    return [delimiter.join(f"{value:.6g}" for value in row) for row in values]


def _marker_rows(delimiter: str = ",") -> list[str]:
    flat = positions().reshape(FRAMES, -1)
    return [delimiter.join(f"{value:.3f}" for value in row) for row in flat]


def trc(delimiter: str = "\t", units: str = "mm") -> str:
    """TRC at 100 frames per second, from frame 5."""
    d = delimiter
    lines = [
        d.join(["PathFileType", "4", "(X/Y/Z)", "take.trc"]),
        d.join(["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"]),
        d.join(["100.00", "100.00", str(FRAMES), str(len(NAMES)), units]),
        d.join(["Frame#", "Time", *(f"{name}{d}{d}" for name in NAMES)]),
        d.join(["", "", *(f"X{i}{d}Y{i}{d}Z{i}" for i in range(1, len(NAMES) + 1))]),
        "",
    ]
    lines += [
        d.join([str(5 + i), f"{0.01 * (4 + i):.3f}", row]) for i, row in enumerate(_marker_rows(d))
    ]
    return "\n".join(lines) + "\n"


def vicon_csv(delimiter: str = ",") -> str:
    """A Vicon export at 120 frames per second, with a block of devices before the markers."""
    d = delimiter
    lines = ["Devices", "1000", f"{d}{d}Force Plate", f"Frame{d}Sub Frame{d}Fx", f"{d}{d}N"]
    lines += [f"{1 + i // 2}{d}{i % 2}{d}0.{i}" for i in range(4)]
    lines += ["", "Trajectories", "120"]
    lines += [d.join(["", "", *(f"Kim:{name}{d}{d}" for name in NAMES)]).rstrip(d) + d + d]
    lines += [d.join(["Frame", "Sub Frame", *["X", "Y", "Z"] * len(NAMES)])]
    lines += [d.join(["", "", *["mm"] * (3 * len(NAMES))])]
    lines += [d.join([str(1 + i), "0", row]) for i, row in enumerate(_marker_rows(d))]
    return "\n".join(lines) + "\n"


def motive_csv(labelled: bool = True) -> str:
    """A Motive export at 240 frames per second in metres, with a rigid body and its markers."""
    first = [
        "Format Version", "1.23", "Take Name", "kitchen", "Capture Frame Rate", "240.000000",
        "Export Frame Rate", "240.000000", "Rotation Type", "Quaternion", "Length Units", "Meters",
        "Coordinate Space", "Global",
    ]  # fmt: skip
    kinds = ["Rigid Body"] * 7 + ["Rigid Body Marker"] * 3 + ["Marker"] * 15
    names = ["Head"] * 7 + ["Head:Marker1"] * 3
    names += [f"Face:{name}" for name in NAMES for _ in range(3)] + ["Unlabeled 1021"] * 3
    values = ["Rotation"] * 4 + ["Position"] * 18
    axes = ["X", "Y", "Z", "W"] + ["X", "Y", "Z"] * 7
    lines = [",".join(first), ""]
    lines += [",".join(["", "Type" if labelled else "", *kinds])]
    lines += [",".join(["", "Name" if labelled else "", *names])]
    lines += [",".join(["", "ID" if labelled else "", *(f'"{i:X}"' for i in range(25))])]
    if labelled:
        lines += [",".join(["", "Parent", *["Head"] * 10, *["Face"] * 15])]
    lines += [",".join(["", "", *values, *["Position"] * 3])]
    lines += [",".join(["Frame", "Time (Seconds)", *axes])]
    for i, row in enumerate(positions().reshape(FRAMES, -1) / 1000):
        cells = [f"{value:.6f}" for value in row]
        lines += [",".join([str(i), f"{i / 240:.6f}", *["0.1"] * 10, *cells, "", "", ""])]
    return "\n".join(lines) + "\n"


def live_link_csv(step: int = 2, base: int = 60, start: str = "13:59:58:53") -> str:
    """A Live Link Face recording whose rows come every `step` frames of its timecode."""
    hours, minutes, seconds, frames = (int(part) for part in start.split(":"))
    first = ((hours * 60 + minutes) * 60 + seconds) * base + frames
    lines = [",".join(["Timecode", "BlendShapeCount", *SHAPES, *ROTATIONS])]
    for i, row in enumerate(_rows(weights())):
        clock, frame = divmod(first + step * i, base)
        minute, second = divmod(clock, 60)
        stamp = f"{minute // 60 % 24:02d}:{minute % 60:02d}:{second:02d}:{frame:02d}.250"
        lines += [f"{stamp},{len(SHAPES + ROTATIONS)},{row}"]
    return "\n".join(lines) + "\n"


def face_cap() -> str:
    """A Face Cap recording at 60 frames per second; angles in degrees."""
    lines = ["info,timestamp in nanoseconds, ...", "bs," + ",".join(SHAPES)]
    for i, row in enumerate(_rows(weights()[:, : len(SHAPES)])):
        lines += [f"k,{round(i * 1000 / 60)},1,2,3,10,20,30,1,2,3,4,{row}"]
    return "\n".join(lines) + "\n"


def ifacialmocap(separator: str = "\n", mark: str = "-") -> str:
    """A saved iFacialMocap stream; weights from 0 to 100, angles in degrees."""
    frames = []
    for row in (weights()[:, : len(SHAPES)] * 100).round():
        shapes = "|".join(
            f"{name}{mark}{value:.0f}" for name, value in zip(SHAPES, row, strict=True)
        )
        frames.append(f"{shapes}|=head#-90,0,45,1,2,3|rightEye#1,2,3|leftEye#4,5,6|")
    return separator.join(frames) + separator


def openface_csv() -> str:
    """OpenFace at 25 frames per second: landmarks and two action units; frame 4 fails."""
    count = len(NAMES)
    titles = ["frame", " face_id", " timestamp", " confidence", " success", " gaze_0_x"]
    titles += [f" {axis}_{i}" for axis in "XYZ" for i in range(count)]
    titles += [" AU01_r", " AU12_r", " AU01_c"]
    lines = [",".join(titles)]
    for i, cloud in enumerate(positions() + np.array([0, 0, 500])):
        success = int(i != 3)
        cells = [f"{value:.3f}" for value in cloud.T.ravel()]
        cells += [f"{0.1 * i * success:.2f}", f"{success * 5.0:.2f}", "1"]
        lines += [
            ", ".join([str(i + 1), "0", f"{i / 25:.3f}", "0.98", str(success), "0.1", *cells])
        ]
    return "\n".join(lines) + "\n"


def marker_csv() -> str:
    """A plain table at 60 frames per second in centimetres, from frame 0."""
    titles = ["frame", "time_s", *(f"{name}.{axis}" for name in NAMES for axis in "xyz")]
    lines = [",".join(titles)]
    for i, row in enumerate(positions().reshape(FRAMES, -1) / 10):
        lines += [",".join([str(i), f"{i / 60:.5f}", *(f"{value:.4f}" for value in row)])]
    return "\n".join(lines) + "\n"


def weights_csv() -> str:
    """A plain table of weights."""
    rows = [f"{n + 1};{n / 60:.6f};{row[0]:.4f};{row[1]:.4f}" for n, row in enumerate(weights())]
    return "\n".join(["Frame;time_s;JawOpen;mouth_frown_L", *rows]) + "\n"


def weights_json() -> str:
    """Weights as Audio2Face writes them."""
    matrix = weights().round(4).tolist()
    names = [f"shape{number}" for number in range(len(matrix[0]))]
    return json.dumps({"exportFps": 60.0, "facsNames": names, "weightMat": matrix}, indent=1)


TEXTS = {
    "trc": trc,
    "motive-csv": motive_csv,
    "vicon-csv": vicon_csv,
    "live-link-csv": live_link_csv,
    "face-cap": face_cap,
    "ifacialmocap": ifacialmocap,
    "openface-csv": openface_csv,
    "marker-csv": marker_csv,
    "weights-csv": weights_csv,
    "weights-json": weights_json,
}


def c3d(folder: Path) -> bytes:
    """A C3D of the same markers."""
    path = folder / "sample.c3d"
    write_c3d(path, positions(), np.ones((FRAMES, len(NAMES)), bool), list(NAMES), rate=60)
    return path.read_bytes()


def npy(folder: Path) -> bytes:
    """A matrix of weights, with its names beside it."""
    path = folder / "sample.npy"
    np.save(path, weights())
    names = [f"shape{number}" for number in range(weights().shape[1])]
    (folder / "kitchen.names.txt").write_text("\n".join(names))
    return path.read_bytes()
