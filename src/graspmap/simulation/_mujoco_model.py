"""One compiled MuJoCo model for all grasps of a tabletop.

Grasp frame: origin on the table under the middle of the opening, x along the opening, z up, metres.
In it the gripper has three joints (its base slides along z, each finger along x), so the jaw size,
the opening and the place of a grasp are numbers that change without compiling anything.

Letters in shapes: B objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.gripper import Gripper
from graspmap.simulation.numerics import Numerics
from graspmap.simulation.objects import ObjectModel

Floats = NDArray[np.float64]

# Two geometries touch when a contype of one meets a conaffinity of the other: objects touch all,
# the gripper only objects.
_TABLE, _GRIPPER = 1, 2
_PALM_THICKNESS_M = 0.02
# The base follows its path on a spring, critically damped, about as stiff as an arm: it gives way
# by 1 mm to 20 N. A rigid one would wedge slanted things against the table with any force.
_BASE_MASS_KG = 4.0
_BASE_STIFFNESS_N_M = 20000.0
_ROLLING_FRICTION_M = 1e-4
# Fingers are tied to each other as stiffly as the coarsest time step allows.
_COUPLING_TIME_S = 0.004


@dataclass(frozen=True, eq=False)
class GripperParts:
    """Where the gripper is in the model's arrays.

    Args:
        base_q: Position of the base's height in qpos; its speed is qvel[base_v].
        base_v: See ``base_q``.
        finger_q: (2,) of the right (x > 0) and the left finger's half opening.
        finger_v: (2,) likewise in qvel.
        geoms: (2,) geometries of the right and the left finger.
    """

    base_q: int
    base_v: int
    finger_q: NDArray[np.intp]
    finger_v: NDArray[np.intp]
    geoms: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class World:
    """A compiled model, its state, and where things are in their arrays.

    Args:
        model: MuJoCo's model.
        data: MuJoCo's state.
        bodies: (B,) number of each object's body.
        body_q: (B,) where its seven positions (x, y, z, quaternion w x y z) begin in qpos.
        body_v: (B,) where its six speeds begin in qvel.
        owner: (geometries,) number of the object each belongs to, -1 for table and gripper.
        gripper: The gripper's parts, None in a world without one.
    """

    model: Any
    data: Any
    bodies: NDArray[np.intp]
    body_q: NDArray[np.intp]
    body_v: NDArray[np.intp]
    owner: NDArray[np.intp]
    gripper: GripperParts | None
    _compiled: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        model = self.model
        names = ("body_mass", "body_inertia", "body_subtreemass", "body_invweight0")
        for name in (*names, "dof_invweight0", "dof_M0", "geom_friction"):
            self._compiled[name] = getattr(model, name).copy()

    def reset(self) -> None:
        """Back to the compiled state: nothing of what ran before is left."""
        for name, values in self._compiled.items():
            getattr(self.model, name)[:] = values
        self.model.opt.gravity[:] = (0.0, 0.0, -9.81)
        mujoco.mj_resetData(self.model, self.data)

    def scale_mass(self, factor: float) -> None:
        """Make every object heavier by a factor, with what the solver derives from it."""
        model = self.model
        dofs = (self.body_v[:, None] + np.arange(6)).ravel()
        for name in ("body_mass", "body_inertia", "body_subtreemass"):
            getattr(model, name)[self.bodies] *= factor
        model.body_invweight0[self.bodies] /= factor
        model.dof_invweight0[dofs] /= factor
        model.dof_M0[dofs] *= factor

    def set_jaw(self, size_m: float) -> None:
        """Size of the finger plates across the opening."""
        assert self.gripper is not None
        model = self.model
        for geom in self.gripper.geoms:
            model.geom_size[geom, 1] = size_m / 2
            half = model.geom_size[geom]
            model.geom_rbound[geom] = np.linalg.norm(half)
            model.geom_aabb[geom, 3:] = half
            # The box by which MuJoCo finds the pieces of an object near the finger, whose only
            # geometry this is.
            model.bvh_aabb[model.body_bvhadr[model.geom_bodyid[geom]], 3:] = half

    def scale_friction(self, factor: float) -> None:
        """Make the finger pads rougher by a factor, against sliding and against twisting."""
        assert self.gripper is not None
        self.model.geom_friction[self.gripper.geoms, :2] *= factor

    def unstable(self) -> bool:
        """Whether the state became meaningless (MuJoCo then starts it anew by itself)."""
        warnings = self.data.warning
        kinds = mujoco.mjtWarning
        bad = (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)
        return any(warnings[kind].number for kind in bad)


def compile_world(
    objects: Sequence[ObjectModel], gripper: Gripper | None, numerics: Numerics
) -> World:
    """A table with free objects and, where one is given, a gripper above it.

    Raises:
        InvalidInputError: MuJoCo can make no bodies of the objects' pieces, masses or inertias.
    """
    spec = _empty(numerics)
    if len(objects) > 1:
        # Things that do not touch are solved apart: more than twice as quick with six objects, a
        # little slower with one.
        spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    table = spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE)
    table.size = [1, 1, 0.1]
    table.contype = table.conaffinity = _TABLE
    _contact(table, numerics)
    for number, item in enumerate(objects):
        _add_object(spec, number, item, numerics)
    if gripper is not None:
        _add_gripper(spec, gripper, numerics)
    try:
        model = spec.compile()
    except ValueError as error:
        names = ", ".join(item.id for item in objects)
        raise InvalidInputError(
            f"shape of {names}", str(error).splitlines()[0], "solid convex pieces with a mass"
        ) from error
    return _index(model, len(objects), gripper)


def _empty(numerics: Numerics) -> Any:
    spec = mujoco.MjSpec()
    spec.compiler.boundmass, spec.compiler.boundinertia = 1e-6, 1e-10
    option = spec.option
    option.timestep = numerics.timestep_s
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations = numerics.solver_iterations
    # Friction cones need more than the usual steps of the line search, or verdicts become noise.
    option.ls_iterations = 50
    option.tolerance = numerics.solver_tolerance
    option.impratio = numerics.impratio
    option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    return spec


def _contact(geom: Any, numerics: Numerics, condim: int = 3) -> None:
    geom.condim = condim
    geom.friction = [
        numerics.table_friction,
        numerics.torsional_friction_m,
        _ROLLING_FRICTION_M,
    ]
    geom.solref = [numerics.contact_time_s, 1.0]
    geom.solimp[:3] = numerics.contact_impedance


def _add_object(spec: Any, number: int, item: ObjectModel, numerics: Numerics) -> None:
    body = spec.worldbody.add_body(name=f"object{number}")
    body.add_freejoint(name=f"object{number}")
    inertia = (np.asarray(item.inertia) + np.asarray(item.inertia).T) / 2
    body.explicitinertial = 1
    body.mass = item.mass_kg
    body.ipos = [0.0, 0.0, 0.0]
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    for count, piece in enumerate(item.pieces):
        name = f"object{number}_{count}"
        mesh = spec.add_mesh(name=name)
        mesh.uservert = np.ascontiguousarray(piece, dtype=np.float64).ravel()
        mesh.maxhullvert = numerics.hull_vertices
        geom = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
        geom.contype = geom.conaffinity = _TABLE | _GRIPPER
        geom.mass = 0.0
        _contact(geom, numerics)


def _add_gripper(spec: Any, gripper: Gripper, numerics: Numerics) -> None:
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    base = spec.worldbody.add_body(name="base", gravcomp=1.0)
    base.explicitinertial = 1
    base.mass, base.inertia = _BASE_MASS_KG, [1.0, 1.0, 1.0]
    base.add_joint(name="base", type=slide, axis=[0, 0, 1])
    length, thick = gripper.finger_length_m, gripper.finger_thickness_m
    palm = base.add_geom(name="palm", type=mujoco.mjtGeom.mjGEOM_BOX)
    palm.size = [*(np.asarray(gripper.palm_size_m) / 2), _PALM_THICKNESS_M / 2]
    palm.pos = [0, 0, length + _PALM_THICKNESS_M / 2]
    palm.contype = palm.conaffinity = _GRIPPER
    palm.mass = 0.0
    _contact(palm, numerics)
    for name, side in (("right", 1.0), ("left", -1.0)):
        body = base.add_body(name=name, gravcomp=1.0)
        body.explicitinertial = 1
        body.mass, body.inertia = gripper.finger_mass_kg, [1e-4, 1e-4, 1e-4]
        joint = body.add_joint(name=name, type=slide, axis=[side, 0, 0])
        # A constant force against this damping: all of it at standstill, none at full speed. (A
        # servo with a limited force would jump from limit to limit between two time steps.)
        joint.damping[0] = gripper.force_n / gripper.closing_speed_m_s
        joint.limited = True
        joint.range = [gripper.min_opening_m / 2, gripper.max_opening_m / 2]
        joint.solref_limit = [numerics.contact_time_s, 1.0]
        geom = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX)
        geom.size = [thick / 2, 0.01, length / 2]
        geom.pos = [side * thick / 2, 0.0, length / 2]
        geom.contype = geom.conaffinity = _GRIPPER
        geom.mass = 0.0
        _contact(geom, numerics, condim=4)
        geom.friction = [gripper.friction, gripper.torsional_friction_m, _ROLLING_FRICTION_M]
        geom.priority = 1
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
    # Together they follow the integral of one speed: where it should be, and how fast.
    place = spec.add_actuator(name="place", target="base", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    place.set_to_intvelocity(kp=_BASE_STIFFNESS_N_M)
    place.actrange = [-10, 10]
    speed = spec.add_actuator(name="speed", target="base", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    moving = _BASE_MASS_KG + 2 * gripper.finger_mass_kg
    speed.set_to_velocity(kv=2 * (_BASE_STIFFNESS_N_M * moving) ** 0.5)
    couple = spec.add_equality(name="couple", type=mujoco.mjtEq.mjEQ_JOINT)
    couple.objtype = mujoco.mjtObj.mjOBJ_JOINT
    couple.name1, couple.name2 = "left", "right"
    couple.data[:5] = [0.0, 1.0, 0.0, 0.0, 0.0]
    couple.solref = [_COUPLING_TIME_S, 1.0]
    couple.solimp[:3] = [0.95, 0.99, 0.0005]
    spec.add_exclude(bodyname1="left", bodyname2="right")


def _index(model: Any, count: int, gripper: Gripper | None) -> World:
    bodies = np.array([model.body(f"object{i}").id for i in range(count)], dtype=np.intp)
    owner = np.full(model.ngeom, -1, dtype=np.intp)
    for number, body in enumerate(bodies):
        owner[model.geom_bodyid == body] = number
    joints = [model.joint(f"object{i}") for i in range(count)]
    parts = None
    if gripper is not None:
        fingers = [model.joint(name) for name in ("right", "left")]
        parts = GripperParts(
            base_q=int(model.joint("base").qposadr[0]),
            base_v=int(model.joint("base").dofadr[0]),
            finger_q=np.array([j.qposadr[0] for j in fingers], dtype=np.intp),
            finger_v=np.array([j.dofadr[0] for j in fingers], dtype=np.intp),
            geoms=np.array([model.geom(n).id for n in ("right", "left")], dtype=np.intp),
        )
    return World(
        model=model,
        data=mujoco.MjData(model),
        bodies=bodies,
        body_q=np.array([j.qposadr[0] for j in joints], dtype=np.intp),
        body_v=np.array([j.dofadr[0] for j in joints], dtype=np.intp),
        owner=owner,
        gripper=parts,
    )
