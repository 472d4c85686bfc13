//! Bad input ends with exit code 2 and a message with file, key and value; nothing is started or written.

use crate::common::{Bench, SPEC};

/// Lines that a material replaces.
const MATERIAL: &str = "density = 1e-8\nstiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }\n";

/// Text to replace in the spec, replacement, part of the message.
const EDITS: &[(&str, &str, &str)] = &[
    ("name = \"s\"\n", "", "s.toml:1: name: must be set; it has no default"),
    ("columns = 6\n", "", "s.toml:2: body.columns: must be set if body.file is not"),
    (
        "[sweep]",
        "[sweep]\n\"sensors.channels\" = [[\"az\"]]",
        "s.toml:14: sensors.channels = [\"az\"]: must be a list of \"ax\", \"ay\" or \"omega\"",
    ),
    ("columns = 6", "columns = 99999999999", "s.toml:3: body.columns = 99999999999: must be at most 1000"),
    (
        "[sweep]",
        "[brain]\niterations = 9223372036854775807\n[sweep]",
        "s.toml:14: brain.iterations = 9223372036854775807: must be at most 10000000",
    ),
    (
        "[sweep]",
        "[evaluation]\nlong_iterations = 9223372036854775807\n[sweep]",
        "s.toml:14: evaluation.long_iterations = 9223372036854775807: must be at most 10000000",
    ),
    (
        "[sweep]",
        "[optimise]\nbatch = 9223372036854775807\n[sweep]",
        "s.toml:14: optimise.batch = 9223372036854775807: must be at most 1000000",
    ),
    (
        "[sweep]",
        "[run]\nthreads = 1000000000\n[sweep]",
        "s.toml:14: run.threads = 1000000000: must be at least 1, at most 1024",
    ),
    (
        "columns = 6",
        "colums = 6",
        "s.toml:3: body.colums = 6: unknown key; the nearest known one is \"body.columns\"",
    ),
    (
        "samples = 12",
        "sample = 12",
        "s.toml:11: stimuli.sample = 12: unknown key; the nearest known one is \"stimuli.samples\"",
    ),
    (
        "rows = 6",
        "rows = 6\nlayout = \"circular\"",
        "s.toml:4: body.rows = 6: must be left out for a circular body: body.columns counts its units across",
    ),
    ("rows = 6", "rows = 1", "s.toml:4: body.rows = 1: must be at least 2"),
    ("columns = 6", "columns = 0", "s.toml:3: body.columns = 0: "),
    ("columns = 6", "columns = 6.5", "s.toml:3: body.columns = 6.5: must be a whole number"),
    ("columns = 6", "columns = -9223372036854775809", "s.toml:3: body.columns = -9223372036854775809: "),
    ("panels = [2]", "panels = [9223372036854775808]", "s.toml:14: sweep.panels = [9223372036854775808]: "),
    ("panels = [2]", "panels = [9223372036854775807]", "s.toml:14: sweep.panels = 9223372036854775807: "),
    ("[sweep]", "[time]\nduration = 1e300\n[sweep]", "s.toml:14: time.duration = 1e300: "),
    ("spacing = 15.0", "spacing = nan", "s.toml:5: body.spacing = nan: nan is not a finite number"),
    ("spacing = 15.0", "spacing = -15.0", "s.toml:5: body.spacing = -15: "),
    (
        "spacing = 15.0",
        "spacing = 2.0",
        "s.toml:6: body.ligament_length = 2.25: must be less than body.spacing",
    ),
    (
        "columns = 6",
        "columns = 6\ndiameter = 90.0",
        "s.toml:4: body.diameter = 90: only for circular bodies; use body.width for a planar body",
    ),
    ("columns = 6", "columns = 6\nwidth = 0.0", "s.toml:4: body.width = 0: must be a number above 0"),
    (
        "[sweep]",
        "[variation]\nstretch = 0.05\n[evaluation]\nrecords = false\n[goal]\nerror = 3.0\nquantile = 0.9\n\
         reader = { records = 10 }\n[sweep]",
        "s.toml:16: evaluation.records = false: must be true: goal.reader is fitted to records of a cast",
    ),
    ("density = 1e-8", "density = 0.0", "s.toml:7: body.density = 0: "),
    ("density = 1e-8\n", "", "body.density: must be set, unless body.material is set"),
    (
        "density = 1e-8",
        "density = 1e-8\nmaterial = { rubber = \"Dragon Skin 10\", thickness = 10, ligament_width = 2 }",
        "s.toml:7: body.density = 0.00000001: cannot be set together with body.material, which determines it",
    ),
    (
        "density = 1e-8",
        "material = { rubber = \"Dragon Skin 10\", thickness = 10, ligament_width = 2 }",
        "s.toml:8: body.stiffness = { … }: cannot be set together with body.material, which determines it",
    ),
    (
        MATERIAL,
        "material = { rubber = \"Dragon Skin 10\", thickness = -10, ligament_width = 2 }\n",
        "s.toml:7: body.material.thickness = -10: must be a number above 0",
    ),
    (
        MATERIAL,
        "material = { rubber = \"Dragon Skin 10\", thickness = 10, ligament_width = 0 }\n",
        "s.toml:7: body.material.ligament_width = 0: must be a number above 0",
    ),
    (
        "ligament_length = 2.25\ndensity = 1e-8\nstiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }\n",
        "material = { rubber = \"Dragon Skin 10\", thickness = 10, ligament_width = 2 }\n",
        "body.ligament_length: must be set if body.file is not",
    ),
    (
        MATERIAL,
        "material = { modulus = 0.2, thickness = 10, ligament_width = 2 }\n",
        "body.material.density: must be set, unless body.material.rubber is set",
    ),
    (
        MATERIAL,
        "material = { rubber = \"Dragon Skin 1\", thickness = 10, ligament_width = 2 }\n",
        "s.toml:7: body.material.rubber = \"Dragon Skin 1\": must be \"Dragon Skin 10\"",
    ),
    ("density = 1e-8", "density = 1e-8\ndamping_ratio = -0.1", "s.toml:8: body.damping_ratio = -0.1: "),
    ("density = 1e-8", "density = 1e-8\ninitial_angle = 60.0", "s.toml:8: body.initial_angle = 60: "),
    ("density = 1e-8", "density = 1e-8\nclamp = [99]", "s.toml:8: body.clamp = 99: "),
    (
        "density = 1e-8",
        "density = 1e-8\ndamping = [1e-4, -1, 0]",
        "s.toml:8: body.damping = [0.0001, -1.0, 0.0]: ",
    ),
    (
        "density = 1e-8",
        "density = 1e-8\ndamping = [0, 0, 0]\ndamping_ratio = 0.1",
        "s.toml:9: body.damping_ratio = 0.1: ",
    ),
    (
        "density = 1e-8",
        "density = 1e-8\nguides = [{ units = \"sides\", holds = [\"z\"] }]",
        "s.toml:8: body.guides.holds = [\"z\"]: must be a list of \"x\", \"y\" or \"turn\"",
    ),
    (
        "density = 1e-8",
        "density = 1e-8\nguides = [{ units = \"sides\", hold = [\"x\"] }]",
        "s.toml:8: body.guides.hold = [\"x\"]: unknown key; the nearest known one is \"body.guides.holds\"",
    ),
    (
        "density = 1e-8",
        "density = 1e-8\nguides = [{ units = [99], holds = [\"x\"] }]",
        "s.toml:8: body.guides = 99: the layout's units are 0 to 35",
    ),
    ("density = 1e-8", "density = 1e-8\npanel_angle = 90", "s.toml:8: body.panel_angle = 90: removed: "),
    ("density = 1e-8", "density = 1e-8\npanel_units = [31]", "sweep.panels = 2: "),
    (
        "density = 1e-8",
        "density = 1e-8\npanels = [{ unit = 31 }]",
        "sweep.panels = 2: body.panels names 1 panels",
    ),
    (
        "density = 1e-8",
        "density = 1e-8\npanel_units = [31, 34]\npanels = [{ unit = 31 }]",
        "body.panel_units = [31, 34]: cannot be set together with body.panels",
    ),
    (
        "density = 1e-8",
        "density = 1e-8\npanels = [{ unit = 31, directoin = [1, 0] }, { unit = 34 }]",
        "s.toml:8: body.panels.directoin = [1, 0]: unknown key; the nearest known one is \"body.panels.direction\"",
    ),
    (
        "density = 1e-8",
        "density = 1e-8\npanels = [{ unit = 31 }, { unit = 31, node = 7 }]",
        "body.panels = panels[1]: unit 31 has no node 7",
    ),
    ("density = 1e-8", "density = 1e-8\npanel_units = [31, 77]", "s.toml:8: body.panel_units = 77: "),
    ("stretch = 3.0", "stretch = -3.0", "s.toml:8: body.stiffness.stretch = -3: "),
    ("bend = 1.0", "bend = inf", "s.toml:8: body.stiffness.bend = inf: "),
    (
        "test = 4",
        "test = 12",
        "s.toml:12: stimuli.test = 12: must be less than stimuli.samples = 12: the rest",
    ),
    ("test = 4", "test = 0", "s.toml:12: stimuli.test = 0: "),
    (
        "test = 4",
        "test = 4\nanywhere = true\nsilent = 0.5",
        "s.toml:13: stimuli.anywhere = true: cannot be set together with silent, offset and angle",
    ),
    (
        "test = 4\n[sweep]\npanels = [2]",
        "test = 4\nanywhere = true\n[sweep]\npanels = [1]",
        "s.toml:13: stimuli.anywhere = true: needs at least two panels (sweep.panels)",
    ),
    (
        "kind = \"bell\"",
        "kind = \"mix\"\nanywhere = true",
        "s.toml:11: stimuli.anywhere = true: has no effect on this stimuli.kind",
    ),
    ("test = 4", "test = 4\nsilent = 1.5", "s.toml:13: stimuli.silent = 1.5: must lie between 0 and 0.99"),
    (
        "kind = \"bell\"",
        "kind = \"gauss\"\npeak = [0.3, 0.4]",
        "s.toml:11: stimuli.peak = [0.3, 0.4]: has no effect",
    ),
    (
        "[sweep]\n",
        "[[evaluation.under]]\nkind = \"bell\"\n[[evaluation.under]]\namplitude = [0.1, 0.2]\n[sweep]\n",
        "evaluation.under.kind: must be set; it has no default",
    ),
    (
        "test = 4\n",
        "test = 4\nonset = [-5, -4]\n",
        "s.toml:13: stimuli.onset = [-5, -4]: must let the latest and widest pulse end after 0 s",
    ),
    (
        "test = 4\n",
        "test = 4\nonset = [2, 3]\n",
        "s.toml:13: stimuli.onset = [2, 3]: must begin before the sample ends, at time.duration = 1 s",
    ),
    (
        "[sweep]\n",
        "[[evaluation.under]]\nkind = \"bell\"\n[[evaluation.under]]\nkind = \"bell\"\n[sweep]\n",
        "evaluation.under = [\"bell\", \"bell\"]: must contain kinds other than mix, each once",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[optimise]\nobjective = \"mean\"\ncasts = 3\n[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\n[[stimuli.mix]]\nweight = 0.5\nkind = \"bell\"\n[[stimuli.mix]]\nweight = 0.5\nkind = \"irregular\"\n",
        "optimise.casts = 3: must be left out: without a [variation]",
    ),
    (
        "[sweep]\n",
        "[[evaluation.under]]\nkind = \"bell\"\nweight = 0.5\n[sweep]\n",
        "evaluation.under.weight = 0.5: has no effect",
    ),
    (
        "[sweep]\n",
        "[[evaluation.under]]\nkind = \"irregular\"\ndouble = 2.0\n[sweep]\n",
        "evaluation.under.double = 2: must lie between 0 and 1",
    ),
    ("[sweep]\n", "[[evaluation.under]]\nkind = \"recorded\"\n[sweep]\n", "stimuli.recorded: must be set"),
    (
        "[sweep]\n",
        "[[evaluation.under]]\nkind = \"bell\"\nwdth = [0.1, 0.2]\n[sweep]\n",
        "evaluation.under.wdth = [0.1, 0.2]: unknown key; the nearest known one is \"evaluation.under.width\"",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\n[[stimuli.mix]]\nkind = \"bell\"\n[[stimuli.mix]]\nweight = 0.4\nkind = \"irregular\"\n",
        "stimuli.mix.weight: must be set for each part",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\n[[stimuli.mix]]\nweight = 0.5\nkind = \"bell\"\n[[stimuli.mix]]\nweight = 0.4\nkind = \"irregular\"\n",
        "s.toml:14: stimuli.mix.weight = [0.5, 0.4]: must sum to 1, not to 0.9",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\n[[stimuli.mix]]\nweight = 1.5\nkind = \"bell\"\n[[stimuli.mix]]\nweight = -0.5\nkind = \"irregular\"\n",
        "s.toml:14: stimuli.mix.weight = [1.5, -0.5]: must be numbers above 0",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\n[[stimuli.mix]]\nweight = 1.0\nkind = \"bell\"\n",
        "s.toml:13: stimuli.mix = [\"bell\"]: must be at least two tables [[stimuli.mix]]",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\n",
        "s.toml:9: stimuli.mix = []: must be at least two tables [[stimuli.mix]]",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\n[[stimuli.mix]]\nweight = 0.5\n[[stimuli.mix]]\nweight = 0.5\nkind = \"irregular\"\n",
        "s.toml:13: stimuli.mix.kind: must be set; it has no default",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\n[[stimuli.mix]]\nweight = 0.5\nkind = \"bell\"\n[[stimuli.mix]]\nweight = 0.5\nkind = \"mix\"\n",
        "s.toml:13: stimuli.mix = [\"bell\", \"mix\"]: must not contain a mixture",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\n[[stimuli.mix]]\nweight = 0.5\nkind = \"bell\"\ndouble = 0.5\n[[stimuli.mix]]\nweight = 0.5\nkind = \"irregular\"\n",
        "stimuli.mix.double = 0.5: has no effect on this stimuli.kind",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\nwidth = [0.1, 0.2]\n[[stimuli.mix]]\nweight = 0.5\nkind = \"bell\"\n[[stimuli.mix]]\nweight = 0.5\nkind = \"irregular\"\n",
        "s.toml:13: stimuli.width = [0.1, 0.2]: has no effect on this stimuli.kind",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\n[[stimuli.mix]]\nweight = 0.5\nkind = \"bell\"\nwdth = 0.5\n",
        "s.toml:16: stimuli.mix.wdth = 0.5: unknown key; the nearest known one is \"stimuli.mix.width\"",
    ),
    (
        "test = 4",
        "test = 4\noffset = -1",
        "s.toml:13: stimuli.offset = -1: must lie between 0 and 3.1875 mm, a quarter of a unit's diagonal",
    ),
    (
        "test = 4",
        "test = 4\noffset = 4.0",
        "s.toml:13: stimuli.offset = 4: must lie between 0 and 3.1875 mm, a quarter",
    ),
    ("test = 4", "test = 4\noffset = nan", "s.toml:13: stimuli.offset = nan: nan is not a finite number"),
    ("test = 4", "test = 4\noffset = [1, 2]", "s.toml:13: stimuli.offset"),
    (
        "test = 4",
        "test = 4\nangle = 45",
        "s.toml:13: stimuli.angle = 45: must lie between 0 and 30 degrees: with larger deviations, blows could pull",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\nangle = 5\n[[stimuli.mix]]\nweight = 0.5\nkind = \"bell\"\n[[stimuli.mix]]\nweight = 0.5\nkind = \"irregular\"\n",
        "s.toml:13: stimuli.angle = 5: has no effect on this stimuli.kind",
    ),
    (
        "[stimuli]\nkind = \"bell\"\nsamples = 12\ntest = 4\n",
        "[stimuli]\nkind = \"mix\"\nsamples = 12\ntest = 4\n[[stimuli.mix]]\nweight = 0.5\nkind = \"bell\"\n[[stimuli.mix]]\nweight = 0.5\nkind = \"irregular\"\noffset = -0.5\n",
        "stimuli.mix.offset = -0.5: must lie between",
    ),
    ("test = 4", "test = 4\nholdout = 0", "s.toml:13: stimuli.holdout = 0: "),
    (
        "test = 4",
        "test = 4\namplitude = [0.0, 0.0]",
        "s.toml:13: stimuli.amplitude = [0.0, 0.0]: must contain a value other than 0",
    ),
    (
        "[sweep]\n",
        "[brain]\nkind = \"stacked\"\nscaling = \"minmax\"\n[sweep]\n",
        "brain.scaling = \"minmax\": must be \"rms\" with casts",
    ),
    ("test = 4", "test = 4\namplitude = [0.5, 0.1]", "s.toml:13: stimuli.amplitude = [0.5, 0.1]: "),
    ("test = 4", "test = 4\npeak = [0.0, 1.5]", "s.toml:13: stimuli.peak = "),
    ("kind = \"bell\"", "kind = \"recorded\"", "s.toml:9: stimuli.recorded: must be set: the files"),
    (
        "density = 1e-8",
        "density = 1e-8\ndesign = \"nothere.npy\"",
        "s.toml:8: body.design = \"nothere.npy\": reading nothere.npy: No such file or directory (os error 2); file \
         names are relative to the folder of the spec",
    ),
    ("panels = [2]", "panels = [7]", "s.toml:14: sweep.panels = 7: "),
    ("panels = [2]", "", "s.toml:13: sweep.panels: needs at least one value"),
    (
        "panels = [2]",
        "panels = [2]\npoints = [{ \"body.columns\" = 6 }, { \"body.columns\" = 7.5 }]",
        "s.toml:15: body.columns = 7.5: must be a whole number of at least 0",
    ),
    (
        "panels = [2]",
        "points = [\n  { panels = 2 },\n  { panels = 7 },\n]",
        "s.toml:16: sweep.panels = 7: the top row of 6 units has no room for 7 panels",
    ),
    (
        "panels = [2]",
        "points = [\n  { panels = 2 },\n  { \"body.columns\" = 7 },\n]",
        "s.toml:14: sweep.points = [ { panels = 2 }, { \"body.columns\" = 7 }, ]: either all points must set panels, or none",
    ),
    (
        "panels = [2]",
        "panels = [2]\n\"body.columns\" = [6, 7]\npoints = [{ \"body.rows\" = 6, \"body.columns\" = 8 }]",
        "s.toml:16: sweep.points.\"body.columns\" = 8: is also in a list of [sweep]",
    ),
    (
        "panels = [2]",
        "panels = [2]\npoints = [{ panels = 4 }]",
        "s.toml:15: sweep.points.panels = 4: is also in a list of [sweep]",
    ),
    (
        "panels = [2]",
        "panels = [2]\n[[sweep.points]]\n\"body.colums\" = 8\n[sweep.unread]",
        "s.toml:16: sweep.points.\"body.colums\" = 8: unknown key; the nearest known one is \"body.columns\"",
    ),
    (
        "panels = [2]",
        "panels = [2]\npoints = [{ seed = 8 }]",
        "s.toml:15: sweep.points.seed = 8: unknown key; the nearest known one is \"sweep.seeds\"",
    ),
    (
        "panels = [2]",
        "panels = [2]\npoints = [{ \"body.columns\" = 8 }, { \"body.columns\" = 8 }]",
        "s.toml:15: sweep.points = { \"body.columns\" = 8 }: is listed twice",
    ),
    (
        "panels = [2]",
        "panels = [2]\npoints = [{ \"body.columns\" = 8 }]\nexclude = [{ \"body.rows\" = 8 }]",
        "s.toml:16: sweep.exclude = 8: unknown key \"body.rows\"; known keys here: body.columns, panels, \
         placement, seed, sensors",
    ),
    (
        "panels = [2]",
        "panels = [2]\nexclude = [{ body.columns = 5 }]",
        "s.toml:15: sweep.exclude = {\"columns\":5}: write the path of each key in quotes: \"body.columns\" = 5",
    ),
    (
        "density = 1e-8",
        "density = 1e-8\ncompression = [0, 0, 0.3]",
        "s.toml:8: body.compression = [0, 0, 0.3]: must be a list of 2 numbers",
    ),
    (
        "samples = 12",
        "samples = 12\namplitude = [0.1, 0.5, 9]",
        "s.toml:12: stimuli.amplitude = [0.1, 0.5, 9]: must be a list of 2 numbers",
    ),
    (
        "panels = [2]",
        "panels = [2]\nseeds = [9007199254740993]",
        "s.toml:15: sweep.seeds = 9007199254740993: must be at most 4503599627370496",
    ),
    (
        "[sweep]",
        "[until]\npaired = 0.5\nat_most = { seeds = 1600 }\n[sweep]",
        "until.at_most.seeds = 1600: must be at least 1, at most 1000",
    ),
    ("panels = [2]", "panels = [0]", "s.toml:14: sweep.panels = 0: "),
    ("panels = [2]", "panels = []", "s.toml:14: sweep.panels = []: needs at least one value"),
    ("panels = [2]", "panels = [2, 2]", "s.toml:14: sweep.panels = 2: is listed twice"),
    (
        "panels = [2]",
        "panels = [2]\n\"body.spacing\" = [15, 15.0]",
        "s.toml:15: body.spacing = 15.0: is listed twice",
    ),
    (
        "panels = [2]",
        "points = [{ panels = 2, body.columns = 5 }]",
        "s.toml:14: sweep.points.body: must not be a table; write the path of each key in quotes: \"body.columns\" = 5",
    ),
    (
        "name = \"s\"",
        "name = \"long_name_long_name_long_name_long_name_long_name_long_name_long_name_long_name_long_name_long_name_x\"",
        "…: must have at most 100 bytes, because it names files",
    ),
    ("sensors = [1, 2]", "sensors = [17]", "s.toml:15: sweep.sensors = 17: the body has 16 free units"),
    (
        "sensors = [1, 2]",
        "sensors = [17]\n\"sensors.search\" = [\"greedy\"]",
        "sweep.sensors = 17: the body has 16 units on which sensors.search may place a sensor",
    ),
    (
        "sensors = [1, 2]",
        "sensors = [1]\nplacements = 17\n\"sensors.search\" = [\"greedy\"]",
        "sweep.placements = 17: the body has 16 units",
    ),
    ("sensors = [1, 2]", "sensors = [1]\nplacements = 0", "s.toml:16: sweep.placements = 0: "),
    (
        "sensors = [1, 2]",
        "sensors = [1]\nown_placements = true\n[sensors]\nplacements = [[14]]",
        "s.toml:16: sweep.own_placements = true: cannot be set together with sensors.search or sensors.placements",
    ),
    (
        "sensors = [1, 2]",
        "sensors = [1]\nown_placements = true\nseeds = [1, 2, 3, 4]\n[until]\npaired = 0.1",
        "s.toml:16: sweep.own_placements = true: cannot be set together with [until]",
    ),
    (
        "sensors = [1, 2]",
        "sensors = [1]\nown_placements = true\nseeds = [1, 2, 3, 4]\n[goal]\nerror = 3.0",
        "s.toml:16: sweep.own_placements = true: cannot be set together with [goal]",
    ),
    (
        "sensors = [1, 2]",
        "sensors = [1]\nown_placements = true\n\"sensors.search\" = [\"random\", \"greedy\"]",
        "s.toml:16: sweep.own_placements = true: cannot be set together with sensors.search or sensors.placements",
    ),
    (
        "sensors = [1, 2]",
        "sensors = [1]\n\"body.stiffness.bend\" = [1.0, -1.0]",
        "s.toml:16: body.stiffness.bend = -1: ",
    ),
    (
        "sensors = [1, 2]",
        "sensors = [1]\n\"body.columns\" = [5, \"six\"]",
        "s.toml:16: body.columns = \"six\": must be a whole number of at least 0",
    ),
    (
        "panels = [2]",
        "panels = [2]\npoints = [{ \"body.material.rubber\" = \"Dragon Skin 10\", \"body.material.thickness\" = \"thin\" }]",
        "s.toml:15: body.material.thickness = \"thin\": must be a number",
    ),
    (
        "panels = [2]",
        "panels = [2]\npoints = [{ \"body.material.thickness\" = 10.0 }]",
        "s.toml:15: body.material.thickness = 10.0: missing field `ligament_width`",
    ),
    // the message has the key's own line, also if the sweep varies another key or this key
    (
        "sensors = [1, 2]",
        "sensors = [1]\n\"body.columns\" = [5, 6]\n[body.contact]\nmin_angle = nan",
        "s.toml:18: body.contact.min_angle = nan: nan is not a finite number",
    ),
    (
        "sensors = [1, 2]",
        "sensors = [1]\n\"body.contact.stiffness\" = [5, 6]\n[body.contact]\nstiffness = \"six\"",
        "s.toml:18: body.contact.stiffness = \"six\": must be a number",
    ),
    ("sensors = [1, 2]", "sensors = [1]\n\"body.colums\" = [5]", "nearest known one is \"body.columns\""),
    (
        "sensors = [1, 2]",
        "sensors = [1]\nexclude = [{ sensor = 1 }]",
        "nearest known one here is \"sensors\"",
    ),
    (
        "sensors = [1, 2]",
        "sensors = [1]\nexclude = [{ sensors = 1 }]",
        "s.toml:16: sweep.exclude = [{ sensors = 1 }]: excludes all trials",
    ),
    ("sensors = [1, 2]", "sensors = [1]\nplacements = 9000000", "at most 1000000 are allowed"),
    (
        "sensors = [1, 2]",
        "sensors = [1]\n\"body.stiffness\" = [{ stretch = 3, shear = 0.5, bend = 1 }]\n\"body.stiffness.bend\" = [1.0, 5.0]",
        "s.toml:17: body.stiffness.bend = [1.0, 5.0]: is part of \"body.stiffness\", which [sweep] sets, too",
    ),
    (
        "panels = [2]",
        "panels = [2]\n\"optimise.coarse.tolerance\" = [0.01]\npoints = [{ \"optimise.coarse\" = { tolerance = 0.03 } }]",
        "s.toml:15: optimise.coarse.tolerance = [0.01]: is part of \"optimise.coarse\"",
    ),
    (
        "sensors = [1, 2]",
        "sensors = [1]\n\"goal.error\" = [1.0, 2.0]",
        "s.toml:16: sweep.\"goal.error\" = [1.0, 2.0]: is not a setting of a trial and cannot be swept",
    ),
    (
        "sensors = [1, 2]",
        "sensors = [1]\n\"variation.stretch\" = [0.0]",
        "s.toml:16: variation: must contain at least one deviation",
    ),
    (
        "sensors = [1, 2]",
        "sensors = [1]\nexclude = [{ sensors = 1.0 }]",
        "s.toml:16: sweep.exclude = 1.0: \"sensors\" must be a whole number of at least 0",
    ),
    ("rows = 6", "rows = 2000", "s.toml:4: body.rows = 2000: gives 12000 units; a body has at most 10000"),
    (
        "columns = 6",
        "columns = 6\nclamp = \"ends\"",
        "s.toml:4: body.clamp = ends: holds unit 31, on which a panel acts: set body.panel_units to free units",
    ),
    (
        "density = 1e-8",
        "density = 1e-8\npanel_units = [30, 31, 34]",
        "body.panel_units names 3 units: name as many units as panels",
    ),
    ("name = \"s\"", "name = \"../s\"", "s.toml:1: name = \"../s\": "),
    ("name = \"s\"", "name = ", "s.toml:1: not valid TOML"),
];

/// Tables before `[sweep]`, and part of the message.
const TABLES: &[(&str, &str)] = &[
    (
        "[variation]\nstretch = -0.1",
        "s.toml:14: variation.stretch = -0.1: must be a standard deviation of the logarithm from 0 to 1",
    ),
    (
        "[variation]\nshear = { common = 0.05, ligament = -0.03 }",
        "s.toml:14: variation.shear.ligament = -0.03: must be a standard deviation of the logarithm from 0 to 1",
    ),
    (
        "[variation]\nbend = { common = nan, ligament = 0.03 }",
        "s.toml:14: variation.bend.common = nan: nan is not a finite number",
    ),
    (
        "[variation]\ndensity = { unit = 1.5 }",
        "s.toml:14: variation.density.unit = 1.5: must be a standard deviation of the logarithm from 0 to 1",
    ),
    (
        "[variation]\nligament_length = 0.4",
        "s.toml:14: variation.ligament_length = 0.4: must be a standard deviation of the logarithm from 0 to 0.316",
    ),
    (
        "[variation]\nrelaxation = { share = -0.2, time = 0.01 }",
        "s.toml:14: variation.relaxation.share = -0.2: must lie between 0 and 1",
    ),
    (
        "[variation]\nrelaxation = { share = 0.2, time = 0.0 }",
        "s.toml:14: variation.relaxation.time = 0: must lie between 1e-4 and 1000 s",
    ),
    ("[variation]\nrelaxation = { share = 0.2 }", "variation.relaxation"),
    (
        "[variation]\nstretch = {}",
        "s.toml:14: variation.stretch: must be a number or a table { common, ligament }",
    ),
    ("[variation]\nstretch = { unit = 0.05 }", "s.toml:14: variation.stretch.unit = 0.05: unknown key"),
    (
        "[variation]\nstretch = { ligament = 0.0 }",
        "s.toml:13: variation: must contain at least one deviation",
    ),
    (
        "[variation]\nnodes = 0.4",
        "s.toml:14: variation.nodes = 0.4: must lie between 0 and 0.375 mm, a sixth of body.ligament_length",
    ),
    (
        "[variation]\nnodes = { scatter = 0.4, correlation = 15.0 }",
        "s.toml:14: variation.nodes.scatter = 0.4: must lie between 0 and 0.375 mm",
    ),
    (
        "[variation]\nnodes = { scatter = 0.1, correlation = -1.0 }",
        "s.toml:14: variation.nodes.correlation = -1: must lie between 0 and 10000 mm",
    ),
    (
        "[variation]\ncontact = 0.1",
        "s.toml:14: variation.contact = 0.1: has no effect: the body has no body.contact",
    ),
    ("[sensors]\nmass = 9.0", "s.toml:14: sensors.mass = 9: must be at most 1e-3 Mg (1 kg); 9 g = 9e-6 Mg"),
    (
        "[sensors]\nbandwidth = 0.0",
        "s.toml:14: sensors.bandwidth = 0: must be above 0, and at most 400 Hz, twice the rate of the readings",
    ),
    (
        "[sensors]\nbandwidth = 500.0",
        "s.toml:14: sensors.bandwidth = 500: must be above 0, and at most 400 Hz",
    ),
    (
        "[sensors]\ndelay = 0.01\n[time]\nsamples = 20000",
        "s.toml:14: sensors.delay = 0.01: needs 8 instants of motion per reading, so that time.samples must be at most 12500",
    ),
    (
        "[sensors]\nbandwidth = 4000.0\ndelay = 0.001\n[time]\nsamples = 2000",
        "s.toml:14: sensors.bandwidth = 4000: needs 64 instants of motion per reading",
    ),
    ("[sensors]\ninertia = 2.0", "s.toml:14: sensors.inertia = 2: must be at most 1 Mg mm²"),
    (
        "[sensors]\noffset = [0.0, 2e3]",
        "s.toml:14: sensors.offset = [0.0, 2000.0]: must be two numbers from -1000 to 1000 mm",
    ),
    (
        "[sensors]\nchannels = []",
        "s.toml:14: sensors.channels = []: must name some of \"ax\", \"ay\", \"omega\", each once",
    ),
    (
        "[sensors]\nchannels = [\"ax\", \"ax\"]",
        "s.toml:14: sensors.channels = [\"ax\", \"ax\"]: must name some of",
    ),
    (
        "[sensors]\nchannels = [\"az\"]",
        "s.toml:14: sensors.channels = [\"az\"]: must be a list of \"ax\", \"ay\" or \"omega\"",
    ),
    (
        "[variation]\ngain = 1.5",
        "s.toml:14: variation.gain = 1.5: must be a standard deviation of the logarithm from 0 to 1",
    ),
    (
        "[variation]\nmisalignment = -2.0",
        "s.toml:14: variation.misalignment = -2: must be a standard deviation from 0 to 45 degrees",
    ),
    ("[variation]\nnodes = 0.0", "s.toml:13: variation: must contain at least one deviation"),
    (
        "[optimise]\nobjective = \"mean\"",
        "s.toml:14: optimise.objective = \"mean\": needs a [variation] or a mixture",
    ),
    (
        "[variation]\nnodes = 0.1\n[optimise]\nprotocol = \"paper\"\nobjective = \"worst\"",
        "s.toml:17: optimise.objective = \"worst\": has no effect on this optimise.protocol, only on joint",
    ),
    (
        "[variation]\nnodes = 0.1\n[optimise]\nobjective = { cvar = 1.5 }",
        "optimise.objective.cvar = 1.5: must lie between 0 and 1",
    ),
    (
        "[variation]\nnodes = 0.1\n[optimise]\ncasts = 4",
        "s.toml:16: optimise.casts = 4: has no effect: no trial has an optimise.objective over casts",
    ),
    ("[evaluation]\ncasts = 4", "s.toml:14: evaluation.casts = 4: has no effect: no trial has a [variation]"),
    ("[run]\ntime_limit = nan", "s.toml:14: run.time_limit = nan: nan is not a finite number"),
    ("[run]\ntime_limit = 2e9", "s.toml:14: run.time_limit = 2e9: must be at least 0.1, at most 1e9"),
    ("[run]\nno_progress = 1", "s.toml:14: run.no_progress = 1: must be at least 2, at most 1e9"),
    ("[run]\nbackoff = 2e9", "s.toml:14: run.backoff = 2e9: must be at least 0, at most 1e9"),
    ("[run]\ngrace = -1", "s.toml:14: run.grace = -1: must be at least 0, at most 3600"),
    ("[run]\ngrace = 3601", "s.toml:14: run.grace = 3601: must be at least 0, at most 3600"),
    ("[run]\nthreads = 1025", "s.toml:14: run.threads = 1025: must be at least 1, at most 1024"),
    ("[run]\nniceness = -1", "s.toml:14: run.niceness = -1: must be a whole number from 0 to 19"),
    ("[run]\nniceness = 20", "s.toml:14: run.niceness = 20: must be at most 19"),
    ("[feasible]\nclearance = 30.0", "s.toml:2: body.initial_angle = 25: the initial body is not feasible"),
    (
        "[sensors]\nrange = [0.0, 1.0]",
        "s.toml:14: sensors.range = [0.0, 1.0]: must be above 0: [mm/s², rad/s]",
    ),
    (
        "[sensors]\nresolution = [1e6, 0.0]\nchip = \"WT9011DCL\"",
        "s.toml:14: sensors.resolution = [1000000.0, 0.0]: must be at least 0 and less than sensors.range: [mm/s², rad/s]",
    ),
    ("[sensors]\nchip = \"MPU9250\"", "s.toml:14: sensors.chip"),
    ("[optimise]\ntie = [0, 2]", "s.toml:14: optimise.tie = [0, 2]: must be two numbers from 1 to 1000"),
    ("[optimise]\nfrozen = [99]", "s.toml:14: optimise.frozen = 99: the layout's units are 0 to 35"),
    (
        "[optimise]\nprotocol = \"random\"\nbatch = 4",
        "s.toml:15: optimise.batch = 4: has no effect on this optimise.protocol, only on joint",
    ),
    (
        "[optimise]\nprotocol = \"random\"\ngradient = \"direct\"",
        "s.toml:15: optimise.gradient = \"direct\": has no effect on this optimise.protocol, only on paper",
    ),
    (
        "[brain]\ntask = \"panel\"",
        "s.toml:14: brain.task = \"panel\": set brain.kind = \"linear\": other decoders estimate forces only",
    ),
    (
        "[brain]\nkind = \"linear\"\ntask = \"count\"",
        "s.toml:15: brain.task = \"count\": the label is the same in all training samples: vary [stimuli]",
    ),
    (
        "[brain]\nkind = \"linear\"\ntask = \"kind\"",
        "s.toml:15: brain.task = \"kind\": the label is the same in all training samples: vary [stimuli]",
    ),
    ("[brain]\nkind = \"linear\"\ntask = \"force\"", "s.toml:15: brain.task = \"force\": must be \"forces\""),
    (
        "[brain]\nkind = \"linear\"\ntask = \"peak\"\nmemory = [0.1, 0.0]",
        "s.toml:16: brain.memory = [0.1, 0.0]: has no effect: no trial has brain.kind = \"linear\" and brain.task = \"forces\"",
    ),
    (
        "[brain]\nkind = \"linear\"\ntask = \"onset\"\nwindow = 0.02",
        "s.toml:15: brain.task = \"onset\": the contact gives the onset: remove brain.window, or choose another task",
    ),
    (
        "[brain]\nkind = \"linear\"\nwindow = 0.02",
        "s.toml:15: brain.window = 0.02: has no effect: no trial has evaluation.tasks = true or a brain.task",
    ),
    (
        "[brain]\nkind = \"linear\"\ntask = \"peak\"\nwindow = -0.5",
        "s.toml:16: brain.window = -0.5: must be at least one sampling interval (time.duration / time.samples)",
    ),
    (
        "[brain]\nkind = \"linear\"\ntask = \"peak\"\n[optimise]\nprotocol = \"paper\"",
        "s.toml:15: brain.task = \"peak\": set optimise.protocol = \"joint\" or \"random\"",
    ),
    (
        "[brain]\nkind = \"linear\"\ntask = \"peak\"\n[optimise]\nbatch = 9",
        "s.toml:17: optimise.batch = 9: must be at least 10",
    ),
    (
        "[brain]\nkind = \"linear\"\ntask = \"peak\"\n[optimise]\nobjective = \"worst\"",
        "s.toml:15: brain.task = \"peak\": remove [variation] and optimise.objective",
    ),
    (
        "[brain]\nkind = \"linear\"\ntask = \"all\"\n[optimise]\nobjective = \"mean\"",
        "s.toml:15: brain.task = \"all\": remove [variation] and optimise.objective",
    ),
    (
        "[brain]\nkind = \"linear\"\ntask = \"all\"\n[variation]\nnodes = 0.1",
        "s.toml:15: brain.task = \"all\": remove [variation] and optimise.objective",
    ),
    (
        "[evaluation]\ntasks = true",
        "s.toml:11: stimuli.samples = 12: sensing tasks need ten samples with force for training",
    ),
    ("[evaluation]\ntasks = 1", "s.toml:14: evaluation.tasks = 1: must be true or false"),
    ("[goal]\nerror = 5.0\ntasks = { panel = 0.0 }", "s.toml:15: goal.tasks.panel = 0.0: must be above 0"),
    (
        "[goal]\nerror = 5.0\ntasks = { forces = 1.0 }",
        "s.toml:15: goal.tasks.forces = 1.0: must be above 0, and the task one of panel, count",
    ),
    ("[goal]\nerror = 5.0\ntasks = { place = 1.0 }", "s.toml:15: goal.tasks"),
    ("[until]\npaired = 0.2\nconfidence = 1.5", "s.toml:15: until.confidence = 1.5: must lie in [0.5, 1)"),
    (
        "[[evaluation.under]]\nkind = \"bell\"\nwidth = [0.1, 0.2, 0.3]",
        "evaluation.under.width = [0.1, 0.2, 0.3]: must be a list of 2 numbers",
    ),
    ("[goal]\nerror = 0.0", "s.toml:14: goal.error = 0.0: must be a number above 0"),
    ("[goal]\nerror = 3.0\nquantile = 1.5", "s.toml:15: goal.quantile = 1.5: must be above 0"),
    ("[goal]\nerror = 3.0\nquantile = 0.9", "s.toml:15: goal.quantile = 0.9: applies to casts: set"),
    ("[goal]\nerror = 3.0\nfresh = 1", "s.toml:15: goal.fresh = 1: must be at least 3"),
    ("[goal]\nerror = 3.0\nmemry = 1", "s.toml:15: goal.memry = 1: unknown key; the nearest"),
    ("[until]\npaired = 1.0\n[goal]\nerror = 3.0", "until: cannot be set together with [goal]"),
    ("[evaluation]\nrecords = false", "s.toml:14: evaluation.records = false: has no effect"),
    ("[until]\nconfidence = 0.9", "s.toml:13: until: needs a question: paired, within,"),
    ("[until]\npared = 0.2", "s.toml:14: until.pared = 0.2: unknown key; the nearest known one is"),
    (
        "[evaluation]\ninitial = false\n[until]\npaired = 0.2",
        "s.toml:14: evaluation.initial = false: must be true: until.paired and until.fewer use the initial body",
    ),
    (
        "[until]\npaired = 0.2",
        "s.toml:14: until.paired = 0.2: needs one point with four placements or seeds of each",
    ),
    (
        "[until]\nelbow = true\nat_most = { seeds = 6 }",
        "s.toml:14: until.elbow = true: needs four numbers of sensors with four placements or seeds",
    ),
    (
        "[sensors]\nplacements = 4",
        "s.toml:14: sensors.placements = 4: must be a list of lists of whole numbers of at least 0",
    ),
    ("[time]\nsamples = 0", "s.toml:14: time.samples = 0: "),
    ("[time]\nduration = 1e6", "s.toml:14: time.duration = 1000000: must be at most 86400 s"),
    ("[time]\nduration = -1.0", "s.toml:14: time.duration = -1: "),
    ("[solver]\ntolerance = 0.0", "s.toml:14: solver.tolerance = 0: "),
    ("[solver]\ntolerance = 1e-13", "s.toml:14: solver.tolerance = 0.0000000000001: "),
    ("[solver]\nmethod = \"euler\"", "s.toml:14: solver.method = \"euler\": must be \"auto\", \"tsit5\", "),
    ("[solver]\nmethod = \"implicit\"", "s.toml:14: solver.method = \"implicit\": removed: "),
    (
        "[optimise]\ncoarse = { method = \"implicit\" }",
        "s.toml:14: optimise.coarse.method = \"implicit\": removed: ",
    ),
    ("[run]\nprune = { grace = 2 }", "s.toml:14: run.prune: removed: "),
    ("[run.prune]\ngrace = 2", "s.toml:13: run.prune: removed: "),
    ("[optimise]\nplacement = \"again\"", "s.toml:14: optimise.placement = \"again\": removed: "),
    ("[optimise]\nprotocol = \"cmaes\"", "s.toml:14: optimise.protocol = \"cmaes\": removed: "),
    ("[sensors]\nsearch = \"pivots\"", "s.toml:14: sensors.search = \"pivots\": removed: "),
    (
        "[[sweep.points]]\n\"body.hinge.cubic\" = 10.0",
        "s.toml:14: sweep.points.\"body.hinge.cubic\" = 10.0: removed: ",
    ),
    ("[brain]\niterations = 0", "s.toml:14: brain.iterations = 0: "),
    ("[brain]\nlearning_rate = nan", "s.toml:14: brain.learning_rate = nan: "),
    ("[optimise]\nlearning_rate = -0.1", "s.toml:14: optimise.learning_rate = -0.1: "),
    ("[evaluation]\nlong_iterations = 0", "s.toml:14: evaluation.long_iterations = 0: "),
    ("[evaluation]\nseeds = 0", "s.toml:14: evaluation.seeds = 0: "),
    (
        "[feasible]\nmax_block_angle = 90.0",
        "s.toml:14: feasible.max_block_angle = 90: must be above 90 degrees",
    ),
    (
        "[feasible]\nlimits = false\nmin_edge = 2.0",
        "s.toml:13: feasible: other limits have no effect: no trial has limits = true",
    ),
    ("[feasible]\nclearance = -1.0", "s.toml:14: feasible.clearance = -1: "),
    ("[sensors]\nplacements = [[14], [14, 14]]", "s.toml:14: sensors.placements = 14: "),
    (
        "[sensors]\nplacements = [[14], [14, 15], [15, 14]]",
        "s.toml:14: sensors.placements = [14, 15]: is listed twice",
    ),
    (
        "[sensors]\nplacements = [[14], [14, 15], [8, 9, 8]]",
        "s.toml:14: sensors.placements = 8: is listed twice",
    ),
    ("[sensors]\nplacements = [[14], [2, 14]]", "s.toml:14: sensors.placements = 2: "),
    (
        "[sensors]\nplacements = [[14], [14, 20], [20, 14]]",
        "s.toml:14: sensors.placements = [14, 20]: is listed twice",
    ),
    ("[sensors]\nplacements = [[14]]", "s.toml:14: sensors.placements = [[14]]: contains no list of 2 units"),
    (
        "[sensors]\nplacements = [[99, 8]]",
        "s.toml:14: sensors.placements = 99: the layout's units are 0 to 35",
    ),
    ("[run]\nworkers = 0", "s.toml:14: run.workers = 0: "),
    ("[sensors]\nsearch = \"best\"", "s.toml:14: sensors.search = "),
    (
        "[sensors]\nsearch = \"greedy\"\nplacements = [[14]]",
        "sensors.search = \"greedy\": cannot be set together with sensors.placements",
    ),
    ("[sensors]\noffset = [1.0, nan]", "s.toml:14: sensors.offset = [1.0, nan]: nan is not a finite number"),
    (
        "[sensors]\nmass = 1e-6\noffset = [1.0, 0.0]",
        "s.toml:15: sensors.offset = [1.0, 0.0]: cannot be set together with sensors.mass",
    ),
    (
        "[sensors]\nchip = \"WT9011DCL\"\noffset = [1.0, 0.0]",
        "s.toml:15: sensors.offset = [1.0, 0.0]: cannot be set together with sensors.mass",
    ),
    ("[sensors]\ntilt = 361.0", "s.toml:14: sensors.tilt = 361: must lie between"),
    ("[sensors]\nspacing = 20.0", "sensors.spacing = 20: has no effect without sensors.search"),
    ("[sensors]\nfrom = \"free\"", "sensors.from = \"free\": has no effect without sensors.search"),
    ("[sensors]\nsearch = \"greedy\"\nspacing = 200.0", "sensors.spacing = 200: leaves room for 1 sensors"),
];

#[test]
fn every_error_in_a_spec_names_file_line_key_and_value() {
    let bench = Bench::new();
    let mut wrong = Vec::new();
    let tables = TABLES.iter().map(|(table, said)| ("[sweep]", format!("{table}\n[sweep]"), *said));
    let edits = EDITS.iter().map(|(from, to, said)| (*from, (*to).to_owned(), *said));
    for (i, (from, to, expected)) in edits.chain(tables).enumerate() {
        assert!(SPEC.contains(from), "{from}");
        bench.file("s.toml", &SPEC.replacen(from, &to, 1));
        // both commands use the same function: every eighth case is enough for `run`
        for command in ["run", "expand"].into_iter().skip(usize::from(i % 8 != 0)) {
            let output = bench.metasense(&[command, "s.toml"]);
            let message = String::from_utf8_lossy(&output.stderr).into_owned();
            if output.status.code() != Some(2) || !message.contains(expected) || !message.contains("s.toml:")
            {
                wrong
                    .push(format!("{command}, {to:?}: {}\n  {message}  expected: {expected}", output.status));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(!bench.path("results").exists(), "a run with a bad spec wrote something");
}

/// The end of a pipe that nobody reads; files are still written.
#[test]
fn closed_outputs_change_no_exit_code() {
    let bench = Bench::new();
    bench.file("bad.toml", &SPEC.replacen("columns = 6", "colums = 6", 1));
    bench.file("good.toml", SPEC);
    let parquet = ["expand", "good.toml", "--format", "parquet"];
    for (args, code) in [
        (&["expand", "bad.toml"][..], 2),
        (&parquet[..2], 0),
        (&parquet, 0),
        (&["status", "none"], 2),
        (&["body", "modes", "good.toml", "--out", "m.svg"], 0),
    ] {
        assert_eq!(bench.closed(args), Some(code), "{args:?}");
    }
    assert!(bench.path("m.svg").exists());
}

/// 140 edges are too short; the message lists some and the number of the others.
#[test]
fn an_error_of_many_lines_is_cut_short() {
    let bench = Bench::new();
    bench.file("s.toml", &SPEC.replacen("[sweep]", "[feasible]\nmin_edge = 30.0\n[sweep]", 1));
    let output = bench.metasense(&["expand", "s.toml"]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.lines().count() <= 12 && message.contains("… and 134 more"), "{message}");
}

#[test]
fn files_and_databases_that_cannot_be_used_are_named() {
    let bench = Bench::new();
    bench.file("s.toml", SPEC);
    bench.file("file", "not a database, and not a folder either");
    std::fs::write(bench.path("binary.toml"), [0xff, 0xfe, 0x00]).unwrap();
    bench.file("empty.sqlite", "");
    bench.file("f.csv", "t,f\n0,0\n0.1,1\n");
    let recorded =
        "kind = \"recorded\"\nrecorded = { files = [\"f.csv\", \"f.csv\"], time = \"t\", force = [\"f\"] }";
    bench.file("twice.toml", &SPEC.replacen("kind = \"bell\"", recorded, 1));
    for (args, expected) in [
        (&["run", "none.toml"][..], "cannot read none.toml"),
        (&["run", "binary.toml"], "binary.toml is not UTF-8 (UTF-16 or Latin-1?): save it as UTF-8"),
        (
            &["run", "s.toml", "--db", "file/s.sqlite"],
            "cannot write the database file/s.sqlite; choose another file",
        ),
        (&["run", "s.toml", "--db", "."], "cannot write the database ."),
        (&["run", "s.toml", "--db", "x.log"], "x.log"),
        (&["run", "s.toml", "--copy-every", "1e300", "--shard", "1/2", "--folder", "s"], "--copy-every"),
        (&["run", "s.toml", "--grace", "3601"], "--grace"),
        (&["run", "s.toml", "--db", "file"], "file is not a metasense database"),
        (&["run", "s.toml", "--workers", "0"], "invalid value '0' for '--workers <N>'"),
        (&["query", "none.sqlite", "SELECT 1"], "no database none.sqlite"),
        (&["query", "file", "SELECT 1"], "file is not a metasense database"),
        (&["query", "empty.sqlite", "SELECT 1"], "empty.sqlite is not a metasense database"),
        (&["serve", "file", "--listen", "0"], "file is not a metasense database"),
        (&["trial", "s.toml", "--threads", "3000"], "3000 is not in 1..=1024"),
        (&["status"], "no database in results/"),
        (&["analyse", "none.sqlite", "--within", "-1"], "invalid value '-1' for '--within <PART>'"),
        (
            &["export", "none.sqlite", "ab", "--format", "svg", "--mould", "wall=2", "--out", "x"],
            "--mould: only for --format dxf, stl and device; leave it out",
        ),
        (&["export", "none.sqlite", "", "--format", "npy", "--out", "x"], "is empty: set the variable"),
        (
            &["expand", "s.toml", "body.columns=5", "body.columns=6"],
            "command line: body.columns = 5: is set twice; leave one out",
        ),
        (
            &["lab", "identify", "s.toml", "--records", "r.toml", "--out", "no/t.toml"],
            "--out no/t.toml: the folder no does not exist; create it",
        ),
        (&["body", "place", "s.toml", "--out", "."], "--out .: is a folder; pass a file"),
        (&["body", "place", "s.toml", "--out", "file/p.svg"], "--out file/p.svg: file is not a folder"),
        (
            &["body", "simulate", "s.toml", "--forces", "f.npy", "--out-dir", "file"],
            "--out-dir file: is not a folder; choose another name",
        ),
        (&["run", "twice.toml"], "twice.toml:11: stimuli.recorded.files = "),
        (&["frobnicate"], "unrecognized subcommand 'frobnicate'"),
    ] {
        let output = bench.metasense(args);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {message}");
        assert!(message.contains(expected), "{args:?}: {message}\nexpected: {expected}");
    }
    assert_eq!(
        std::fs::read_to_string(bench.path("file")).unwrap(),
        "not a database, and not a folder either"
    );
}

/// A database in place of a spec is not reported as an invalid spec.
#[test]
fn a_database_is_no_spec() {
    let bench = Bench::new();
    std::fs::write(bench.path("x.sqlite"), b"SQLite format 3\0\xff\xfe").unwrap();
    for command in ["run", "expand"] {
        let output = bench.metasense(&[command, "x.sqlite"]);
        assert_eq!(output.status.code(), Some(2));
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(
            message.contains("x.sqlite is a database; SPEC must be the .toml file of a sweep"),
            "{message}"
        );
    }
}
