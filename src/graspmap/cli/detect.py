"""``graspmap detect``: the best grasps of one picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from graspmap.cli.frame import (
    PICTURE_SUFFIXES,
    numbers,
    option,
    output_file,
    parse,
    teller,
    write_json,
    write_picture,
)
from graspmap.errors import FileFormatError, InvalidInputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from graspmap.inference import Detection, Detector


WEAK = 0.1
"""Quality below which the words say that a grasp is hardly one."""


@dataclass(frozen=True)
class Detect:
    """Find grasps in one picture: where to put a parallel-jaw gripper, how to turn it, how wide.

    Example:
      graspmap detect --rgb scene.png --depth scene.tiff --top 3 --overlay grasps.png
      --json grasps.json

    The network was trained on objects that fill much of its view, on a table: where there is more
    in the picture, say where to look:
      graspmap detect --weights mine.safetensors --depth room.tiff --region 130,150,300,300

    Angles are radians, counter-clockwise on screen, along the opening; x, y, width and height are
    pixels of the picture. With --camera and --depth each grasp also has position_m (x right,
    y down, z forward) and width_m. Quality is the probability that the grasp holds where the
    weights have a calibration (graspmap weights show W).
    """

    weights: Annotated[
        Path | None, option("W", "default: the best that ship for these pictures")
    ] = None
    """Weights file (.safetensors), or the name of shipped weights (`graspmap weights list`)."""
    rgb: Annotated[Path | None, option("F")] = None
    """Colour picture, 8 bits per channel."""
    depth: Annotated[Path | None, option("F")] = None
    """Depth picture: float metres (.tiff, .npy), or 16-bit millimetres (.png)."""
    region: Annotated[str | None, option("X,Y,W,H", "default: the whole picture")] = None
    """Region of interest in pixels: the network looks at the square around it."""
    mask: Annotated[Path | None, option("F")] = None
    """Mask picture: grasps are centred where it is not 0."""
    camera: Annotated[Path | None, option("F")] = None
    """Camera file (JSON or YAML: fx, fy, cx, cy, width, height, or a ROS camera_info)."""
    gripper: Annotated[str | None, option("G", "default: any width")] = None
    """Leave out grasps that this gripper cannot open for: a profile (`graspmap gripper list`) or a
    YAML file; needs --camera and --depth."""
    top: Annotated[int, option("K", "default: 1")] = 1
    """How many grasps at most."""
    method: Annotated[Literal["refined", "ggcnn", "orange"], option("NAME", "default: refined")] = (
        "refined"
    )
    """How grasps are read from the maps: refined, or as published: ggcnn, orange."""
    threshold: Annotated[float | None, option("Q", "default: the method's own")] = None
    """Least quality of a grasp."""
    device: Annotated[str, option("NAME", "default: cpu")] = "cpu"
    """Where the network runs: cpu, cuda, ..."""
    overlay: Annotated[Path | None, option("F")] = None
    """Write a picture (.png or .jpg): the grasps, and the maps beside them."""
    json: Annotated[Path | None, option("F")] = None
    """Write the grasps as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap detect``."""
    flags = parse(Detect, argv, "graspmap detect")
    region = None if flags.region is None else numbers(flags.region, "X,Y,W,H", "--region")
    if flags.rgb is None and flags.depth is None:
        raise InvalidInputError("the picture", "not given", "--rgb, --depth, or both")
    if flags.gripper is not None and (flags.camera is None or flags.depth is None):
        raise InvalidInputError(
            "--gripper", flags.gripper, "only with --camera and --depth: a gripper needs metres"
        )
    gripper_file = None if flags.gripper is None else Path(flags.gripper)
    read = (flags.weights, flags.rgb, flags.depth, flags.mask, flags.camera, gripper_file)
    output_file(flags.overlay, "--overlay", PICTURE_SUFFIXES, keep=read)
    output_file(flags.json, "--json", keep=read)
    from graspmap.geometry import Camera
    from graspmap.gripper import load_gripper
    from graspmap.inference import Detector, default_weights

    weights = flags.weights
    if weights is None:
        weights = default_weights(has_rgb=flags.rgb is not None, has_depth=flags.depth is not None)
        teller(flags.json)(f"weights: {weights.stem}, which ship with graspmap")
    gripper = None if flags.gripper is None else load_gripper(flags.gripper)
    rgb, depth, mask = _pictures(flags)
    camera = None if flags.camera is None else Camera.read(flags.camera)
    image = rgb if rgb is not None else depth
    assert image is not None  # one of the two was given
    if flags.camera is not None and camera is not None:
        rows, columns = image.shape[:2]
        if (camera.width, camera.height) != (columns, rows):
            raise FileFormatError(
                flags.camera,
                f"describes {camera.width} x {camera.height} px, the picture has {columns} x "
                f"{rows}",
                "give the camera file of this picture, or the picture in its full size",
            )
    detector = Detector.load(weights, device=flags.device)
    found = detector.detect(
        rgb,
        depth,
        camera=camera,
        gripper=gripper,
        top=flags.top,
        region=region,
        mask=mask,
        method=flags.method,
        threshold=flags.threshold,
    )
    _report(flags, found)
    if flags.overlay is not None:
        write_picture(flags.overlay, _overlay(flags, found, rgb, depth, detector))
    write_json(to_dict(found, (image.shape[1], image.shape[0])), flags.json)
    return 0


def to_dict(found: Detection, size: tuple[int, int]) -> dict[str, Any]:
    """A detection for machines.

    Args:
        found: What the detector found.
        size: (width, height) of the picture.
    """
    grasps = []
    for i, grasp in enumerate(found.grasps):
        entry: dict[str, Any] = {
            "x": grasp.center[0, 0],
            "y": grasp.center[0, 1],
            "angle": grasp.angle[0],
            "width": grasp.width[0],
            "height": grasp.height[0],
            "quality": grasp.quality[0],
        }
        if found.position_m is not None and found.width_m is not None:
            entry |= {"position_m": found.position_m[i], "width_m": found.width_m[i]}
        grasps.append(entry)
    return {"image": {"width": size[0], "height": size[1]}, "grasps": grasps}


def _pictures(
    flags: Detect,
) -> tuple[NDArray[np.uint8] | None, NDArray[np.float32] | None, NDArray[np.bool_] | None]:
    """Colour, depth and mask, of one size.

    Raises:
        FileError: A file is missing, damaged, of another size than the first, or holds nothing.
    """
    import numpy as np

    from graspmap.data.files import read_depth, read_mask, read_rgb

    rgb = None if flags.rgb is None else read_rgb(flags.rgb)
    depth = None if flags.depth is None else read_depth(flags.depth)
    mask = None if flags.mask is None else read_mask(flags.mask)
    read = [
        (path, image)
        for path, image in ((flags.rgb, rgb), (flags.depth, depth), (flags.mask, mask))
        if path is not None and image is not None
    ]
    first_path, first = read[0]
    for path, image in read[1:]:
        if image.shape[:2] != first.shape[:2]:
            raise FileFormatError(
                path,
                f"is {image.shape[1]} x {image.shape[0]} px, but {first_path} is "
                f"{first.shape[1]} x {first.shape[0]} px",
                "give pictures of one view and one size",
            )
    if flags.depth is not None and depth is not None and np.isnan(depth).all():
        raise FileFormatError(
            flags.depth, "holds no depth, only holes", "take the picture again, or replace it"
        )
    if flags.mask is not None and mask is not None and not mask.any():
        raise FileFormatError(
            flags.mask, "is 0 everywhere", "mark the objects with 255, or leave --mask out"
        )
    return rgb, depth, mask


def _report(flags: Detect, found: Detection) -> None:
    import numpy as np

    tell = teller(flags.json)
    if not len(found.grasps):
        fitting = "" if flags.gripper is None else f" that {flags.gripper} opens wide enough for"
        tell(f"no grasp found{fitting}; try a lower --threshold, or a --region round the objects")
    for i, grasp in enumerate(found.grasps):
        x, y = grasp.center[0]
        metres = ""
        if found.position_m is not None and found.width_m is not None:
            px, py, pz = found.position_m[i]
            metres = f", at ({px:.3f}, {py:.3f}, {pz:.3f}) m, {found.width_m[i]:.3f} m wide"
        tell(
            f"{i + 1}. centre ({x:.1f}, {y:.1f}) px, {np.degrees(grasp.angle[0]):.1f} degrees, "
            f"opening {grasp.width[0]:.1f} px, quality {grasp.quality[0]:.2f}{metres}"
            + (" (weak)" if grasp.quality[0] < WEAK else "")
        )
    if flags.overlay is not None:
        tell(f"overlay: {flags.overlay}")


def _overlay(
    flags: Detect,
    found: Detection,
    rgb: NDArray[np.uint8] | None,
    depth: NDArray[np.float32] | None,
    detector: Detector,
) -> NDArray[np.uint8]:
    from graspmap.pictures import depth_picture, overlay

    picture = rgb
    if picture is None:
        assert depth is not None  # one of the two was given
        picture = depth_picture(depth)
    return overlay(
        picture,
        found.grasps,
        found.maps,
        found.matrix,
        width_scale_px=detector.card.width_scale_px,
        title=(flags.rgb or flags.depth or Path()).name,
    )
