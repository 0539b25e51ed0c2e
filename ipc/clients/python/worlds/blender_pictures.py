#!/usr/bin/env python3
"""Pictures by Blender's path tracer, to judge a detector: depth of field, glossy paper, soft shadows, a lens without distortion.

    pip install bpy==5.0.1 -r ipc/clients/python/requirements-worlds.txt        # Python 3.11; 370 MB
    S=ipc/scene/scenes/tags-robot
    vpc-camera tags $S.toml -o tags.svg
    python3 ipc/clients/python/worlds/blender_pictures.py --scene $S.toml --starts $S-starts.csv --tags tags.svg FOLDER
    (cd ipc/clients && cargo run --release --example judge -- FOLDER --json) | python3 ipc/clients/python/worlds/blender_pictures.py FOLDER

The first call writes FOLDER/00.png and so on, and to FOLDER/truth.json where the tags' centres are; the second compares.
"""

import argparse
import json
import math
import pathlib
import sys
import tempfile

import lockstep
import numpy as np

# The lens: focal length of a small camera, m, its f-number, and where it is focused, m: at the goal. Starts lie up to 20 cm
# beyond, where a point is about a pixel wide.
FOCAL_M, STOP, FOCUS_M = 0.006, 1.8, 0.35
# Paths of light a pixel: they leave some noise, as a camera does.
SAMPLES = 24
# Paper: how rough its gloss is, and how much of it there is.
ROUGHNESS, COAT = 0.25, 0.3
# As Blender has a camera: y up, z backwards.
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
# Half sizes of the box, m.
HALF_BOX = (0.13, 0.11, 0.02)


def material(bpy, name, colour, roughness, coat=0.0):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    surface = made.node_tree.nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = (*colour, 1.0)
    surface.inputs["Roughness"].default_value = roughness
    surface.inputs["Coat Weight"].default_value = coat
    surface.inputs["Coat Roughness"].default_value = roughness
    return made


def paper(bpy, sheet):
    """The sheet as a body in the pattern's frame: x to the right, y down, its face towards -z."""
    left, top, right, bottom = sheet.box
    mesh = bpy.data.meshes.new("sheet")
    mesh.from_pydata([(left, bottom, 0), (right, bottom, 0), (right, top, 0), (left, top, 0)], [], [(0, 3, 2, 1)])
    texture = {0: (0, 0), 1: (1, 0), 2: (1, 1), 3: (0, 1)}
    layer = mesh.uv_layers.new()
    for loop in mesh.loops:
        layer.data[loop.index].uv = texture[loop.vertex_index]
    made = material(bpy, "paper", (1.0, 1.0, 1.0), ROUGHNESS, COAT)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    image = nodes.new("ShaderNodeTexImage")
    with tempfile.TemporaryDirectory() as directory:
        file = str(pathlib.Path(directory) / "tags.png")
        # Ink is not quite black, paper not quite white.
        sheet.image.convert("L").point(lambda level: round(40 + 0.68 * level)).save(file)
        image.image = bpy.data.images.load(file)
        image.image.colorspace_settings.name = "Non-Color"
        image.image.pack()
    links.new(image.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    mesh.materials.append(made)
    body = bpy.data.objects.new("sheet", mesh)
    bpy.context.collection.objects.link(body)
    return body


def camera(bpy, scene):
    """The camera of a scene file; Blender's principal point is the middle of the image, between two pixels."""
    described, eye = scene["camera"], bpy.data.cameras.new("eye")
    width, height = described["width"], described["height"]
    if described["fx"] != described["fy"]:
        raise ValueError(f"fx = {described['fx']}, fy = {described['fy']}; allowed: the same")
    eye.sensor_fit = "HORIZONTAL"
    eye.lens, eye.sensor_width = 1e3 * FOCAL_M, 1e3 * FOCAL_M * width / described["fx"]
    eye.shift_x = (0.5 * (width - 1) - described["cx"]) / width
    eye.shift_y = (described["cy"] - 0.5 * (height - 1)) / width
    eye.clip_start, eye.clip_end = 0.01, 10.0
    eye.dof.use_dof, eye.dof.aperture_fstop, eye.dof.focus_distance = True, STOP, FOCUS_M
    body = bpy.data.objects.new("eye", eye)
    bpy.context.collection.objects.link(body)
    bpy.context.scene.camera = body
    return body


def lamp(bpy, at, side, watts):
    from mathutils import Matrix

    light = bpy.data.lights.new("lamp", "AREA")
    light.size, light.energy = side, watts
    body = bpy.data.objects.new("lamp", light)
    # It shines along its -z: at the pattern.
    z = np.array(at) / np.linalg.norm(at)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.column_stack([x, np.cross(z, x), z]), at
    bpy.context.collection.objects.link(body)
    body.matrix_world = Matrix(matrix.tolist())


def render(arguments, scene):
    import bpy
    from mathutils import Matrix
    from picture import Sheet

    from camera import read_starts

    bpy.ops.wm.read_factory_settings(use_empty=True)
    settings = bpy.context.scene
    settings.render.engine, settings.cycles.device = "CYCLES", "CPU"
    settings.cycles.samples, settings.cycles.use_adaptive_sampling, settings.cycles.use_denoising = SAMPLES, False, False
    settings.render.resolution_x, settings.render.resolution_y = int(scene["camera"]["width"]), int(scene["camera"]["height"])
    settings.cycles.max_bounces = 3
    settings.render.resolution_percentage = 100
    # The levels of a camera without a gamma.
    settings.view_settings.view_transform = "Raw"
    settings.render.image_settings.file_format, settings.render.image_settings.color_mode = "PNG", "BW"
    settings.world = bpy.data.worlds.new("world")
    settings.world.use_nodes = True
    settings.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.25, 0.25, 0.27, 1.0)
    # The pattern is the world's origin, its z away from the camera.
    paper(bpy, Sheet(arguments.tags))
    bpy.ops.mesh.primitive_cube_add(size=2.0, location=(0, 0, 2e-4 + HALF_BOX[2]), scale=HALF_BOX)
    bpy.context.object.data.materials.append(material(bpy, "box", (0.3, 0.2, 0.12), 0.6))
    bpy.ops.mesh.primitive_plane_add(size=4.0, location=(0, 0, 2 * HALF_BOX[2]))
    bpy.context.object.data.materials.append(material(bpy, "table", (0.2, 0.22, 0.25), 0.2, 0.5))
    lamp(bpy, (0.15, -0.12, -1.1), 0.3, 6.0)
    lamp(bpy, (-0.6, 0.5, -0.8), 0.1, 3.0)
    eye = camera(bpy, scene)
    folder = pathlib.Path(arguments.folder)
    folder.mkdir(parents=True, exist_ok=True)
    points, described, truth = np.array(scene["pattern"]["points"]), scene["camera"], []
    for number, start in enumerate(read_starts(arguments.starts)[: arguments.count]):
        object_in_camera = lockstep.pose(start)
        eye.matrix_world = Matrix((lockstep.inverse(object_in_camera) @ OPENGL).tolist())
        settings.cycles.seed = number
        settings.render.filepath = str(folder / f"{number:02}.png")
        bpy.ops.render.render(write_still=True)
        seen = points @ object_in_camera[:3, :3].T + object_in_camera[:3, 3]
        pixels = seen[:, :2] / seen[:, 2:] * [described["fx"], described["fy"]] + [described["cx"], described["cy"]]
        truth.append(pixels.tolist())
        (folder / "truth.json").write_text(json.dumps(truth))


def compare(arguments):
    """What each detector of `judge --json` on standard input missed."""
    truth = json.loads((pathlib.Path(arguments.folder) / "truth.json").read_text())
    for line in sys.stdin:
        if not line.startswith("{"):
            continue
        found, errors = json.loads(line), []
        for number, (frame, pixels) in enumerate(zip(found["frames"], truth, strict=True)):
            tags = {int(tag): centre for tag, centre in frame["tags"].items() if int(tag) < len(pixels)}
            here = {tag: np.subtract(centre, pixels[tag]) for tag, centre in tags.items()}
            if arguments.each:
                print(number, {tag: error.round(3).tolist() for tag, error in here.items()})
            errors += here.values()
        errors = np.array(errors)
        far = np.linalg.norm(errors, axis=1)
        print(
            f"{found['detector']}: {len(errors)} of {4 * len(truth)} tags, {math.sqrt((errors**2).mean()):.3f} px RMS a"
            f" coordinate, mean {errors.mean(axis=0).round(3).tolist()}, median {np.median(far):.3f}, at most {far.max():.3f} px"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder")
    parser.add_argument("--scene", help="scene file (TOML) with tags")
    parser.add_argument("--starts", help="start poses (CSV: tx,ty,tz,rx,ry,rz)")
    parser.add_argument("--tags", help="the printed tags: what `vpc-camera tags` drew of the scene (SVG); renders")
    parser.add_argument("--count", type=int, default=30, help="number of pictures [%(default)s]")
    parser.add_argument("--each", action="store_true", help="print the errors of each picture, px")
    arguments = parser.parse_args()
    if arguments.tags:
        render(arguments, lockstep.read_scene(arguments.scene))
    else:
        compare(arguments)


if __name__ == "__main__":
    main()
