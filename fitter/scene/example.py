"""The scene that ``brdf-fitter scene example`` writes."""

EXAMPLE = """\
# A ball and a tile under a lamp. Lengths in any one unit; every field is in docs/scenes.md.
channels = ["R", "G", "B"]
tolerance = 0.01        # the relative error that a plan may make
bounces = 1             # reflections between shapes

[camera]
position = [0.0, -4.0, 2.2]
look_at = [0.0, 0.0, 0.4]
fov_deg = 34
width = 96
height = 64

[materials.tile]        # a model with its parameters; or fit = "fits/ward.json", or table = "paint.csv"
model = "lambert"
values = { kd = [0.4, 0.38, 0.35] }

[materials.ball]
model = "torrance_sparrow:ggx"
values = { kd = [0.3, 0.06, 0.05], ks = 1.0, f0 = 0.04, alpha = 0.2 }

[[shapes]]
kind = "plane"
material = "tile"
size = [3.0, 3.0]

[[shapes]]
kind = "sphere"
material = "ball"
center = [0.0, 0.0, 0.6]
radius = 0.5

[[lights]]
kind = "directional"
direction = [0.6, -0.8, 1.6]        # towards the light
irradiance = 3.0

[[lights]]
kind = "area"
center = [-1.5, -1.0, 2.5]
normal = [0.5, 0.35, -0.8]
size = [0.8, 0.8]
radiance = [3.0, 3.2, 4.0]
"""
