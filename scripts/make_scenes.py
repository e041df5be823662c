#!/usr/bin/env python3
"""Renders scenes with known geometry, to judge presets on scenes that nobody tuned them on. Path-traced by Cycles on a
CPU (Debian: apt install blender).

Usage: blender -b -P scripts/make_scenes.py -- OUTPUT [--scenes toy,room] [--views N] [--size PX] [--samples N]
           [--fisheye DEGREES]

Each scene is a folder OUTPUT/NAME with images/, transforms.json and points.ply, and OUTPUT/NAME_no_points with the same
photographs and no points. points.ply has 20,000 places that rays through random pixels hit, with noise of 0.2 % of their
distance. truth_mesh.ply has the surfaces of all objects, for `b3dgs mesh --compare`. A scene whose NAME_no_points/transforms.json exists is skipped, and images that exist are kept, whatever the
options: delete the folders to change them.

  toy        an object with alpha, seen from all around; nothing behind it
  wires      a bicycle of thin bars before a fence
  glossy     mirrors and varnish under a sky
  room       a furnished room, seen from inside
  street     houses, trees and a sky, seen by somebody who walks
  exposure   the room from other cameras; the exposure of each photograph differs by up to one stop either way
  terrace    a laid table in a courtyard with plants, seen from all around (readme_pictures.sh)

With --fisheye, photographs are squares in which an equidistant lens shows a circle; mask.pgm leaves out what is around it.
"""
import argparse
import json
import math
import os
import random
import struct
import sys

import bpy
from mathutils import Matrix, Vector

POINTS = 20000
NOISE = 0.002  # standard deviation of a point's coordinates, as a share of its distance from the camera


# ---------------------------------------------------------------------------------------------------- materials

def material(name, color, other, scale=8.0, texture="ShaderNodeTexNoise", roughness=0.8, metallic=0.0):
    """Two colours in a pattern."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    shader = nodes["Principled BSDF"]
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Metallic"].default_value = metallic
    pattern = nodes.new(texture)
    pattern.inputs["Scale"].default_value = scale
    if texture == "ShaderNodeTexNoise":
        pattern.inputs["Detail"].default_value = 8
    ramp = nodes.new("ShaderNodeValToRGB")
    ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[1].position = 0.4, 0.6
    ramp.color_ramp.elements[0].color = (*color, 1)
    ramp.color_ramp.elements[1].color = (*other, 1)
    place = nodes.new("ShaderNodeTexCoord")
    links.new(place.outputs["Object"], pattern.inputs["Vector"])
    links.new(pattern.outputs[0 if texture != "ShaderNodeTexChecker" else 1], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], shader.inputs["Base Color"])
    return made


def lamp_material(strength):
    made = bpy.data.materials.new("lamp")
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    light = nodes.new("ShaderNodeEmission")
    light.inputs["Strength"].default_value = strength
    links.new(light.outputs[0], nodes["Material Output"].inputs["Surface"])
    return made


# ------------------------------------------------------------------------------------------------------ objects

def put(made_of, **_):
    thing = bpy.context.object
    thing.data.materials.append(made_of)
    return thing


def box(made_of, at, size, turn=0.0):
    bpy.ops.mesh.primitive_cube_add(size=1, location=at, rotation=(0, 0, turn))
    thing = put(made_of)
    thing.scale = size
    return thing


def ball(made_of, at, radius):
    bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=at, segments=48, ring_count=24)
    thing = put(made_of)
    bpy.ops.object.shade_smooth()
    return thing


def bar(made_of, start, end, radius):
    start, end = Vector(start), Vector(end)
    along = end - start
    bpy.ops.mesh.primitive_cylinder_add(radius=radius, depth=along.length, location=(start + end) / 2, vertices=16)
    thing = put(made_of)
    thing.rotation_mode = "QUATERNION"
    thing.rotation_quaternion = along.to_track_quat("Z", "Y")
    return thing


def ring(made_of, at, radius, thickness, turn=(0, 0, 0)):
    bpy.ops.mesh.primitive_torus_add(location=at, rotation=turn, major_radius=radius, minor_radius=thickness)
    return put(made_of)


def head(made_of, at, size, turn):
    bpy.ops.mesh.primitive_monkey_add(size=size, location=at, rotation=turn)
    thing = put(made_of)
    thing.modifiers.new("smooth", "SUBSURF").render_levels = 2
    return thing


def mesh(made_of, at, vertices, faces):
    data = bpy.data.meshes.new("mesh")
    data.from_pydata([tuple(vertex) for vertex in vertices], [], faces)
    data.polygons.foreach_set("use_smooth", [True] * len(faces))
    thing = bpy.data.objects.new("mesh", data)
    thing.location = at
    bpy.context.collection.objects.link(thing)
    data.materials.append(made_of)
    return thing


def lathe(made_of, at, profile, folds=0.0, sides=96):
    """Turns a profile of (radius, height) about the vertical axis. Cloth that hangs down has folds."""
    vertices, faces = [], []
    for ring, (radius, height) in enumerate(profile):
        for i in range(sides):
            turn = 2 * math.pi * i / sides
            wave = math.cos(9 * turn) + 0.5 * math.sin(14 * turn)
            r = radius + folds * max(0, profile[0][1] - height) * wave
            vertices.append((r * math.cos(turn), r * math.sin(turn), height))
            if ring:
                a, b = (ring - 1) * sides + i, (ring - 1) * sides + (i + 1) % sides
                faces.append((a, b, b + sides, a + sides))
    return mesh(made_of, at, vertices, faces)


def leaf(vertices, faces, root, turn, rise, length, width, droop):
    """Adds a leaf that starts upwards at the angle `rise` and bends down by `droop` radians."""
    steps, place, start = 5, Vector(root), len(vertices)
    side = Vector((-math.sin(turn), math.cos(turn), 0))
    for step in range(steps + 1):
        half = 0.5 * width * math.sin(math.pi * (0.08 + 0.9 * step / steps))
        bend = rise - droop * step / steps
        along = Vector((math.cos(turn) * math.cos(bend), math.sin(turn) * math.cos(bend), math.sin(bend)))
        crease = side.cross(along) * 0.3 * half
        vertices += [place + side * half - crease, place, place - side * half - crease]
        place = place + along * length / steps
        if step:
            for a in (start + 3 * step - 3, start + 3 * step - 2):
                faces.append((a, a + 1, a + 4, a + 3))


def foliage(made_of, at, count, length, width, chance, rise=(0.5, 1.5), droop=1.6, half=(0, 0, 0)):
    """Leaves from one place, or in an ellipsoid with these half axes."""
    vertices, faces = [], []
    for i in range(count):
        way = Vector([chance.gauss(0, 1) for _ in range(3)]).normalized() * chance.uniform(0.5, 1)
        root, turn = [a * b for a, b in zip(way, half)], 2.4 * i + chance.uniform(-0.3, 0.3)
        leaf(vertices, faces, root, turn, chance.uniform(*rise), length * chance.uniform(0.6, 1), width,
             droop * chance.uniform(0.6, 1.1))
    return mesh(made_of, at, vertices, faces)


def floor(made_of, size, hills=0.0):
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=120, y_subdivisions=120, size=size)
    thing = put(made_of)
    for vertex in thing.data.vertices:
        x, y = vertex.co.x, vertex.co.y
        vertex.co.z = hills * (math.sin(0.7 * x) * math.cos(0.5 * y) + 0.3 * math.sin(2.1 * x + 1.3 * y))
    return thing


def lamp(at, energy, size):
    bpy.ops.object.light_add(type="AREA", location=at)
    bpy.context.object.data.energy = energy
    bpy.context.object.data.size = size


def sky(elevation=0.6, sun=0.3, strength=0.12):
    world = bpy.data.worlds[0] if bpy.data.worlds else bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    texture = nodes.new("ShaderNodeTexSky")
    texture.sky_type = "NISHITA"
    texture.sun_elevation, texture.sun_intensity = elevation, sun
    links.new(texture.outputs[0], nodes["Background"].inputs[0])
    nodes["Background"].inputs[1].default_value = strength


def grey_world(strength):
    world = bpy.data.worlds[0] if bpy.data.worlds else bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (1, 1, 1, 1)
    world.node_tree.nodes["Background"].inputs[1].default_value = strength


# ------------------------------------------------------------------------------------------------------- scenes
# Each function builds its objects and returns (position, target) for view i of n.

def around(radius, low, high, target=(0, 0, 0.6)):
    def camera(i, n, chance):
        turn = 2 * math.pi * (i * 0.618034 % 1)
        up = low + (high - low) * (i + 0.5) / n
        r = radius * chance.uniform(0.9, 1.1)
        return ((r * math.cos(up) * math.cos(turn), r * math.cos(up) * math.sin(turn), r * math.sin(up) + target[2]),
                target)
    return camera


def toy():
    grey_world(1.0)
    lamp((3, -2, 5), 400, 2)
    box(material("body", (0.8, 0.1, 0.05), (0.9, 0.7, 0.1), 12, "ShaderNodeTexVoronoi"), (0, 0, 0.5), (1.4, 0.8, 0.5))
    box(material("cabin", (0.1, 0.3, 0.7), (0.8, 0.9, 1), 20), (-0.3, 0, 0.95), (0.6, 0.7, 0.45))
    tyre = material("tyre", (0.02, 0.02, 0.02), (0.15, 0.15, 0.15), 30)
    for x in (-0.5, 0.5):
        for y in (-0.45, 0.45):
            ring(tyre, (x, y, 0.25), 0.2, 0.08, (math.pi / 2, 0, 0))
    rod = material("rod", (0.9, 0.8, 0.1), (0.3, 0.2, 0.1), 30)
    for i in range(12):
        bar(rod, (0.2 + 0.04 * i, -0.35, 0.75), (0.2 + 0.04 * i, 0.35, 0.95), 0.012)
    head(material("head", (0.2, 0.6, 0.2), (0.9, 0.9, 0.5), 6), (0.45, 0, 1.05), 0.3, (0, 0, 1.2))
    return around(3.6, -0.1, 1.3, (0, 0, 0.5))


def wires():
    sky()
    floor(material("ground", (0.25, 0.2, 0.15), (0.5, 0.5, 0.4), 3), 14)
    steel = material("steel", (0.5, 0.5, 0.55), (0.2, 0.2, 0.25), 40, roughness=0.4)
    for i in range(21):
        bar(steel, (-2 + 0.2 * i, 1.2, 0), (-2 + 0.2 * i, 1.2, 1.1), 0.012)
    for z in (0.2, 1.0):
        bar(steel, (-2, 1.2, z), (2, 1.2, z), 0.02)
    red = material("red", (0.7, 0.05, 0.05), (0.9, 0.3, 0.2), 40)
    for x in (-0.55, 0.55):
        ring(red, (x, 0, 0.4), 0.38, 0.02, (math.pi / 2, 0, 0))
        for i in range(14):
            a = 2 * math.pi * i / 14
            bar(steel, (x, 0, 0.4), (x + 0.37 * math.cos(a), 0, 0.4 + 0.37 * math.sin(a)), 0.004)
    for start, end in (((-0.55, 0, 0.4), (-0.2, 0, 0.85)), ((-0.2, 0, 0.85), (0.4, 0, 0.9)), ((0.55, 0, 0.4), (0.4, 0, 0.9)),
                       ((0, 0, 0.35), (-0.2, 0, 0.85)), ((0, 0, 0.35), (0.4, 0, 0.9)), ((-0.55, 0, 0.4), (0, 0, 0.35))):
        bar(red, start, end, 0.02)
    return around(3.2, 0.15, 0.9, (0, 0, 0.5))


def glossy():
    sky()
    floor(material("tiles", (0.85, 0.85, 0.8), (0.15, 0.2, 0.3), 2, "ShaderNodeTexChecker", roughness=0.3), 12)
    ball(material("mirror", (0.95, 0.95, 0.95), (0.9, 0.9, 0.9), 1, roughness=0.03, metallic=1), (0, 0, 0.6), 0.6)
    ball(material("gold", (1, 0.7, 0.3), (0.9, 0.6, 0.2), 4, roughness=0.2, metallic=1), (1.2, 0.5, 0.35), 0.35)
    ball(material("varnish", (0.6, 0.05, 0.1), (0.1, 0.1, 0.5), 6, roughness=0.08), (-1.1, 0.6, 0.4), 0.4)
    head(material("bronze", (0.5, 0.3, 0.1), (0.3, 0.4, 0.3), 5, roughness=0.25, metallic=1), (0.3, -1.2, 0.5), 0.7,
         (0, 0, -0.6))
    box(material("wood", (0.4, 0.2, 0.08), (0.25, 0.12, 0.05), 15, roughness=0.15), (-0.9, -0.9, 0.3), (0.6, 0.6, 0.6), 0.4)
    return around(4.0, 0.15, 1.0)


def furnish():
    grey_world(0.0)
    lamp((0, 0, 2.55), 120, 1.5)
    wall = material("wall", (0.75, 0.7, 0.6), (0.7, 0.68, 0.62), 1.5)
    for at, size in (((0, 2.5, 1.3), (6, 0.1, 2.6)), ((0, -2.5, 1.3), (6, 0.1, 2.6)), ((3, 0, 1.3), (0.1, 5, 2.6)),
                     ((-3, 0, 1.3), (0.1, 5, 2.6)), ((0, 0, 2.65), (6, 5, 0.1))):
        box(wall, at, size)
    box(material("parquet", (0.45, 0.25, 0.1), (0.3, 0.17, 0.07), 6, "ShaderNodeTexChecker"), (0, 0, -0.05), (6, 5, 0.1))
    chance = random.Random(5)
    shelf = material("shelf", (0.5, 0.35, 0.2), (0.4, 0.28, 0.15), 20)
    for row in range(4):
        box(shelf, (-2.75, 0, 0.4 + 0.5 * row), (0.4, 3, 0.04))
        y = -1.4
        while y < 1.4:
            width, height = chance.uniform(0.04, 0.12), chance.uniform(0.2, 0.4)
            color = [chance.random() for _ in range(3)]
            book = material("book", color, [0.5 * c for c in color], 60)
            box(book, (-2.75, y, 0.42 + 0.5 * row + height / 2), (0.25, width * 0.9, height))
            y += width
    box(material("table", (0.5, 0.3, 0.15), (0.35, 0.2, 0.1), 8, roughness=0.3), (0.6, 0.3, 0.72), (1.4, 0.8, 0.05))
    for x in (0.0, 1.2):
        for y in (0.0, 0.6):
            bar(shelf, (x, y, 0), (x, y, 0.7), 0.03)
    head(material("vase", (0.1, 0.4, 0.6), (0.9, 0.9, 0.9), 8), (0.5, 0.3, 0.95), 0.4, (0, 0, 2))
    ball(material("bowl", (0.9, 0.5, 0.1), (0.8, 0.2, 0.1), 10, roughness=0.2), (1.0, 0.4, 0.85), 0.12)
    box(material("sofa", (0.2, 0.3, 0.25), (0.25, 0.4, 0.3), 40), (0.5, -1.9, 0.35), (2.2, 0.8, 0.7))
    box(material("rug", (0.6, 0.1, 0.1), (0.2, 0.1, 0.3), 10, "ShaderNodeTexVoronoi"), (0.5, 0, 0.005), (2.6, 1.8, 0.01))
    for x in (-1.5, 0.2, 1.9):
        picture = material("picture", [chance.random() for _ in range(3)], [chance.random() for _ in range(3)], 7,
                           "ShaderNodeTexVoronoi")
        box(picture, (x, 2.43, 1.6), (0.9, 0.03, 0.7))


def room():
    furnish()

    def camera(i, n, chance):
        turn = 2 * math.pi * i / n
        at = (1.3 * math.cos(turn) + chance.uniform(-0.3, 0.3), 1.1 * math.sin(turn) + chance.uniform(-0.3, 0.3),
              chance.uniform(1.1, 1.9))
        look = turn + chance.choice((0.0, 0.7, -0.7, math.pi))
        return at, (at[0] + 2 * math.cos(look), at[1] + 2 * math.sin(look), at[2] + chance.uniform(-0.9, 0.2))
    return camera


def street():
    sky()
    floor(material("meadow", (0.1, 0.25, 0.05), (0.3, 0.3, 0.1), 0.8), 120, hills=0.15)
    box(material("road", (0.15, 0.15, 0.15), (0.22, 0.22, 0.2), 3), (0, 0, 0.16), (120, 4, 0.1))
    chance = random.Random(3)
    bark = material("bark", (0.2, 0.12, 0.06), (0.3, 0.2, 0.1), 10)
    leaf = material("leaf", (0.05, 0.2, 0.03), (0.2, 0.4, 0.08), 5)
    roof = material("roof", (0.4, 0.12, 0.07), (0.3, 0.08, 0.05), 8, "ShaderNodeTexChecker")
    for i in range(9):
        for side in (-1, 1):
            x = -24 + 6 * i + chance.uniform(-1, 1)
            if (i + side) % 3 == 0:
                color = [chance.uniform(0.3, 0.9) for _ in range(3)]
                height = chance.uniform(3, 5)
                box(material("house", color, [0.8 * c for c in color], 3), (x, 8 * side, height / 2), (4, 4, height))
                bpy.ops.mesh.primitive_cone_add(vertices=4, radius1=3.2, depth=1.8, location=(x, 8 * side, height + 0.9),
                                                rotation=(0, 0, math.pi / 4))
                put(roof)
                glass = material("glass", (0.05, 0.08, 0.1), (0.1, 0.15, 0.2), 2, roughness=0.1)
                for window in (-1, 1):
                    box(glass, (x + window, 5.97 * side, 1.8), (0.8, 0.06, 1.1))
            else:
                y = side * chance.uniform(3.5, 7)
                bar(bark, (x, y, 0), (x, y, 2), 0.15)
                for _ in range(7):
                    ball(leaf, (x + chance.uniform(-0.7, 0.7), y + chance.uniform(-0.7, 0.7), chance.uniform(2, 3.6)),
                         chance.uniform(0.4, 0.8))

    def camera(i, n, chance):
        at = (-9 + 18 * i / n, chance.uniform(-1.5, 1.5), chance.uniform(1.5, 2.2))
        look = chance.choice((0.0, 0.6, -0.6, 1.3, -1.3))
        return at, (at[0] + math.cos(look), at[1] + math.sin(look), at[2] + chance.uniform(-0.15, 0.1))
    return camera


def masonry(brick, mortar, scale, at, size, turn=(0, 0, 0)):
    made = material("masonry", brick, [0.65 * a for a in brick], 3)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    bricks = nodes.new("ShaderNodeTexBrick")
    bricks.inputs["Scale"].default_value, bricks.inputs["Mortar"].default_value = scale, (*mortar, 1)
    bricks.inputs["Color2"].default_value = [0.8 * a for a in brick] + [1]
    links.new(nodes["Texture Coordinate"].outputs["Object"], bricks.inputs["Vector"])
    links.new(nodes["ColorRamp"].outputs["Color"], bricks.inputs["Color1"])
    links.new(bricks.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    bpy.ops.mesh.primitive_plane_add(size=1, location=at, rotation=turn)
    put(made).scale = (*size, 1)
    bpy.ops.object.transform_apply(location=False, rotation=False)


def two_tone(color, scale=25, roughness=0.8, metallic=0.0):
    return material("two_tone", color, [0.6 * a for a in color], scale, roughness=roughness, metallic=metallic)


def set_table(top, stem, flowers, chance):
    lathe(material("cloth", (0.82, 0.78, 0.7), (0.16, 0.3, 0.42), 4.5, "ShaderNodeTexWave"), (0, 0, top),
          [(0.001, 0.006), (0.5, 0.006), (0.54, 0)] + [(0.55 + 0.01 * i, -0.02 * i) for i in range(1, 9)], folds=0.2)
    lathe(two_tone((0.06, 0.25, 0.45), 9, 0.15), (-0.1, 0.22, top), [
        (0.001, 0), (0.06, 0.01), (0.09, 0.09), (0.07, 0.18), (0.04, 0.23), (0.055, 0.26), (0.045, 0.25), (0.03, 0.2)])
    foliage(stem, (-0.1, 0.22, top + 0.22), 22, 0.24, 0.022, chance, droop=0.9)
    for i in range(13):
        turn, lean = 2.4 * i, 0.03 + 0.011 * i
        at = (-0.1 + lean * math.cos(turn), 0.22 + lean * math.sin(turn), top + 0.5 - 0.01 * i)
        bar(stem, (-0.1, 0.22, top + 0.2), at, 0.003)
        foliage(flowers[i % 3], at, 16, 0.05, 0.022, chance, droop=1.0)
    for i, color in enumerate(((0.5, 0.07, 0.05), (0.07, 0.2, 0.16), (0.75, 0.55, 0.2))):
        turn, at = (0.5, 0.15, 0.75)[i], (-0.33, -0.12, top + 0.03 + 0.045 * i)
        box(two_tone((0.85, 0.8, 0.7), 90), at, (0.25 - 0.02 * i, 0.17, 0.028), turn)
        for side in (-0.017, 0.017):
            box(two_tone(color), (*at[:2], at[2] + side), (0.265 - 0.02 * i, 0.18, 0.006), turn)
    head(two_tone((0.3, 0.25, 0.12), 5, 0.35, 1), (-0.33, -0.12, top + 0.235), 0.13, (0, 0, -0.8))
    lathe(two_tone((0.8, 0.7, 0.55), 12, 0.3), (0.28, 0.2, top + 0.01), [
        (0.001, 0), (0.06, 0), (0.12, 0.04), (0.155, 0.09), (0.145, 0.09), (0.11, 0.05), (0.001, 0.02)])
    fruit = [two_tone((0.85, green, 0.03), 40, 0.4) for green in (0.28, 0.65)]
    for i, (x, y, z) in enumerate(((-0.05, -0.04, 0.08), (0.05, -0.045, 0.08), (0, 0.05, 0.08), (0.08, 0.03, 0.09),
                                   (-0.07, 0.04, 0.085), (0.01, 0, 0.135))):
        ball(fruit[i % 2], (0.28 + x, 0.2 + y, top + z), 0.042)
    white = material("white", (0.8, 0.8, 0.76), (0.55, 0.62, 0.66), 7, roughness=0.2)
    lathe(white, (0.12, -0.26, top), [(0.05, 0), (0.085, 0.04), (0.09, 0.08), (0.06, 0.125), (0.03, 0.14),
                                      (0.012, 0.15), (0.014, 0.165), (0.001, 0.175)])
    ring(white, (0.03, -0.31, top + 0.075), 0.042, 0.008, (math.pi / 2, 0, 0.56))
    bar(white, (0.18, -0.22, top + 0.05), (0.26, -0.17, top + 0.13), 0.014)
    for at in ((0.38, -0.12, top + 0.004), (-0.1, -0.38, top + 0.004)):
        lathe(white, at, [(0.001, 0), (0.05, 0.004), (0.075, 0.014), (0.022, 0.008), (0.036, 0.02), (0.042, 0.07),
                          (0.038, 0.07), (0.03, 0.02), (0.001, 0.012)])


def terrace():
    sky(elevation=0.95, sun=0.25, strength=0.22)
    scene, chance = bpy.context.scene, random.Random(8)
    scene.view_settings.view_transform, scene.view_settings.look = "Filmic", "Medium High Contrast"
    scene.cycles.sample_clamp_indirect, scene.cycles.max_bounces = 2, 3
    masonry((0.38, 0.33, 0.28), (0.07, 0.08, 0.04), 1.6, (0, 0, 0), (8, 8))
    wood, clay = two_tone((0.3, 0.16, 0.07), 14, 0.5), two_tone((0.5, 0.2, 0.1), 6)
    greens = [two_tone(color, 8, 0.5) for color in ((0.08, 0.22, 0.04), (0.2, 0.34, 0.07), (0.12, 0.26, 0.14))]
    flowers = [two_tone(color, 30) for color in ((0.85, 0.1, 0.1), (0.9, 0.65, 0.15), (0.8, 0.35, 0.6))]
    lathe(wood, (0, 0, 0), [(0.001, 0.74), (0.53, 0.74), (0.53, 0.7), (0.05, 0.7), (0.04, 0.4), (0.28, 0)])
    set_table(0.745, greens[0], flowers, chance)
    for turn in (0.4, 4.1):  # two stools
        at = Vector((-0.72 * math.cos(turn), -0.72 * math.sin(turn), 0))
        lathe(wood, at, [(0.001, 0.46), (0.18, 0.46), (0.18, 0.43), (0.001, 0.43)])
        for x, y in ((0.1, 0.1), (-0.1, 0.1), (0.1, -0.1), (-0.1, -0.1)):
            bar(wood, at + Vector((1.4 * x, 1.4 * y, 0)), at + Vector((x, y, 0.44)), 0.018)
    for i in range(16):
        turn, size = 2 * math.pi * i / 16, chance.uniform(0.7, 1.2)
        far = 2.95 / max(abs(math.cos(turn)), abs(math.sin(turn)))
        at = (far * math.cos(turn), far * math.sin(turn))
        lathe(clay, (*at, 0), [(size * a, size * b) for a, b in ((0.12, 0), (0.19, 0.34), (0.21, 0.34), (0.21, 0.4),
                                                                 (0.18, 0.4), (0.17, 0.36), (0.001, 0.35))])
        if i % 2:
            foliage(greens[i % 3], (*at, 0.36 * size), 70, 0.75 * size, 0.07, chance)
        for made, count, length in ((greens[i % 3], 420, 0.11), (flowers[i // 2 % 3], 60, 0.08)) if i % 2 == 0 else ():
            half = (0.3 * size, 0.3 * size, 0.35 * size)
            foliage(made, (*at, 0.7 * size), count, length, 0.6 * length, chance, (-0.3, 0.8), 0.8, half)
    for side in range(4):
        turn = side * math.pi / 2
        along = Vector((math.cos(turn), math.sin(turn), 0))
        wall = Vector((3.4 * math.sin(turn), -3.4 * math.cos(turn), 1.2))
        masonry((0.42, 0.15, 0.09), (0.45, 0.42, 0.38), 2.6, wall, (6.8, 2.4), (math.pi / 2, 0, turn))
        for _ in range(4):  # ivy
            at = wall + along * chance.uniform(-3, 3) + Vector((0, 0, chance.uniform(-0.4, 1)))
            half = (0.06, 0.7, 0.7) if side % 2 else (0.7, 0.06, 0.7)
            foliage(greens[1], at, 600, 0.1, 0.06, chance, (-0.3, 0.8), 0.8, half)

    def camera(i, n, chance):
        turn, r = 2 * math.pi * (i * 0.618034 % 1), chance.uniform(1.4, 1.85)
        target = (chance.uniform(-0.12, 0.12), chance.uniform(-0.12, 0.12), chance.uniform(0.74, 0.89))
        return (r * math.cos(turn), r * math.sin(turn), chance.uniform(1.15, 1.7)), target
    return camera


SCENES = {"toy": (toy, 100), "wires": (wires, 100), "glossy": (glossy, 100), "room": (room, 160), "street": (street, 120),
          "exposure": (room, 120), "terrace": (terrace, 60)}


# ------------------------------------------------------------------------------------------------------ rendering

def empty_scene(size, samples, has_alpha, is_square):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples = "CPU", samples
    scene.cycles.use_denoising = False  # Debian builds Blender without a denoiser
    scene.cycles.max_bounces = 6
    scene.render.resolution_x, scene.render.resolution_y = size, size if is_square else round(0.75 * size)
    scene.render.film_transparent = has_alpha
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA" if has_alpha else "RGB"
    scene.view_settings.view_transform = "Standard"
    scene.render.use_persistent_data = True
    return scene


class Lens:
    """A pinhole, or an equidistant fisheye that shows a circle as wide as the image. Its focal length is in px."""

    def __init__(self, data, scene, millimetres, fisheye):
        self.width, self.height = scene.render.resolution_x, scene.render.resolution_y
        self.is_fisheye = fisheye > 0
        if self.is_fisheye:
            data.type, data.cycles.panorama_type = "PANO", "FISHEYE_EQUIDISTANT"
            data.cycles.fisheye_fov = math.radians(fisheye)
            self.focal = self.width / math.radians(fisheye)
        else:
            data.sensor_fit, data.sensor_width, data.lens = "HORIZONTAL", 36, millimetres
            self.focal = data.lens / data.sensor_width * self.width

    def shows(self, x, y):
        return not self.is_fisheye or math.hypot(x - self.width / 2, y - self.height / 2) < self.width / 2 - 1

    def ray(self, x, y):
        """In the camera's frame, in which it looks along -z and +y is up."""
        right, up = (x - self.width / 2) / self.focal, (self.height / 2 - y) / self.focal
        angle = math.hypot(right, up)
        if not self.is_fisheye or angle == 0:
            return Vector((right, up, -1))
        return Vector((math.sin(angle) * right / angle, math.sin(angle) * up / angle, -math.cos(angle)))

    def write_mask(self, path):
        with open(path, "wb") as file:
            file.write(b"P5\n%d %d\n255\n" % (self.width, self.height))
            file.write(bytes(255 * self.shows(x + 0.5, y + 0.5) for y in range(self.height) for x in range(self.width)))


def points_of(views, folder, lens, scene, has_alpha, chance):
    """Where rays through random pixels hit, with the colours of the photographs there."""
    width, height = lens.width, lens.height
    graph = bpy.context.evaluated_depsgraph_get()
    points = []
    for index, (name, matrix) in enumerate(views):
        image = bpy.data.images.load(os.path.join(folder, name))
        pixels = image.pixels[:]
        origin = matrix.translation
        for _ in range(4 * POINTS // len(views)):
            if len(points) * len(views) >= POINTS * (index + 1):
                break
            x, y = chance.uniform(0, width), chance.uniform(0, height)
            hit, place, _, _, _, _ = scene.ray_cast(graph, origin, matrix.to_3x3() @ lens.ray(x, y))
            if not hit or not lens.shows(x, y):
                continue
            distance = (place - origin).length
            noisy = [value + chance.gauss(0, NOISE * distance) for value in place]
            at = 4 * ((height - 1 - int(y)) * width + int(x))
            points.append((noisy, [min(255, round(255 * value)) for value in pixels[at:at + 3]]))
        bpy.data.images.remove(image)
    return points


def write_ply(path, points):
    with open(path, "wb") as file:
        file.write(b"ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nproperty float y\n"
                   b"property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
                   % len(points))
        for place, color in points:
            file.write(struct.pack("<3f3B", *place, *color))


def write_truth_mesh(path, scene):
    """All meshes of the scene, with modifiers, in world units."""
    graph = bpy.context.evaluated_depsgraph_get()
    vertices, triangles = [], []
    for thing in scene.objects:
        if thing.type != "MESH":
            continue
        shape = thing.evaluated_get(graph)
        data = shape.to_mesh()
        data.calc_loop_triangles()
        first = len(vertices)
        vertices += [thing.matrix_world @ vertex.co for vertex in data.vertices]
        triangles += [[first + k for k in triangle.vertices] for triangle in data.loop_triangles]
        shape.to_mesh_clear()
    with open(path, "wb") as file:
        file.write(b"ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float x\nproperty float y\n"
                   b"property float z\nelement face %d\nproperty list uchar uint vertex_indices\nend_header\n"
                   % (len(vertices), len(triangles)))
        for vertex in vertices:
            file.write(struct.pack("<3f", *vertex))
        for triangle in triangles:
            file.write(struct.pack("<B3I", 3, *triangle))


def make(name, output, views_wanted, size, samples, fisheye):
    folder, bare = os.path.join(output, name), os.path.join(output, name + "_no_points")
    if os.path.exists(os.path.join(bare, "transforms.json")):
        return
    build, n = SCENES[name]
    n = views_wanted or n
    has_alpha = name == "toy"
    scene = empty_scene(size, samples, has_alpha, is_square=has_alpha or fisheye > 0)
    place = build()
    data = bpy.data.cameras.new("camera")
    camera = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(camera)
    scene.camera = camera
    lens = Lens(data, scene, 50 if has_alpha else 35, fisheye)
    chance = random.Random(name)
    views = []
    for i in range(n):
        at, target = place(i, n, chance)
        turn = (Vector(target) - Vector(at)).to_track_quat("-Z", "Y")
        camera.matrix_world = Matrix.Translation(at) @ turn.to_matrix().to_4x4()
        scene.view_settings.exposure = chance.uniform(-1, 1) if name == "exposure" else 0
        file = f"images/{i:04}.png"
        scene.render.filepath = os.path.join(folder, file)
        if not os.path.exists(scene.render.filepath):
            bpy.ops.render.render(write_still=True)
        views.append((file, camera.matrix_world.copy()))
    points = points_of(views, folder, lens, scene, has_alpha, chance)
    write_ply(os.path.join(folder, "points.ply"), points)
    write_truth_mesh(os.path.join(folder, "truth_mesh.ply"), scene)
    json_of_scene = {"w": lens.width, "h": lens.height, "fl_x": lens.focal, "fl_y": lens.focal, "cx": lens.width / 2,
                     "cy": lens.height / 2,
                     "frames": [{"file_path": file, "transform_matrix": [list(row) for row in matrix],
                                 **({"mask_path": "mask.pgm"} if fisheye else {})} for file, matrix in views]}
    os.makedirs(bare, exist_ok=True)
    if not os.path.lexists(os.path.join(bare, "images")):
        os.symlink(os.path.join("..", name, "images"), os.path.join(bare, "images"))
    if fisheye:
        json_of_scene["camera_model"] = "OPENCV_FISHEYE"
        for place_of_mask in folder, bare:
            lens.write_mask(os.path.join(place_of_mask, "mask.pgm"))
    with open(os.path.join(folder, "transforms.json"), "w") as file:
        json.dump({"ply_file_path": "points.ply", **json_of_scene}, file, indent=1)
    with open(os.path.join(bare, "transforms.json"), "w") as file:
        json.dump(json_of_scene, file, indent=1)


def main():
    parser = argparse.ArgumentParser(prog="make_scenes.py")
    parser.add_argument("output")
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--views", type=int, default=0)
    parser.add_argument("--size", type=int, default=400)
    parser.add_argument("--samples", type=int, default=100)
    parser.add_argument("--fisheye", type=float, default=0, help="width of the photographs, degrees; 0: pinholes")
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else [])
    for name in options.scenes.split(","):
        if name not in SCENES:
            parser.error(f"unknown scene: {name} (expected some of {', '.join(SCENES)})")
        make(name, options.output, options.views, options.size, options.samples, options.fisheye)


main()
