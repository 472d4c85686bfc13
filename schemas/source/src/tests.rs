use super::*;

const GOOD: &str = r#"name = "example"
[body]
columns = 6
rows = 6
spacing = 15.0
ligament_length = 2.25
density = 1e-8
stiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }
[stimuli]
kind = "bell"
[sweep]
panels = [2]
sensors = [1, 2]
"body.columns" = [5, 6]
exclude = [{ sensors = 2, "body.columns" = 5 }]
"#;

fn parse(text: &str) -> Result<SweepSpec, SpecError> {
    Source::new("a.toml", text.to_owned())?.parse()
}

fn complaint(from: &str, to: &str) -> String {
    assert!(GOOD.contains(from), "{from}");
    parse(&GOOD.replacen(from, to, 1)).unwrap_err().to_string()
}

#[test]
fn keys_left_out_have_the_defaults_of_the_documentation() {
    let spec = parse(GOOD).unwrap();
    assert_eq!((spec.time.duration, spec.time.samples), (1.0, 200));
    assert_eq!((spec.stimuli.samples, spec.stimuli.test, spec.stimuli.holdout), (470, 200, 300));
    assert_eq!((spec.brain.iterations, spec.optimise.steps(), spec.evaluation.networks()), (1000, 350, 3));
    assert_eq!((spec.sweep.placements, &spec.sweep.seeds[..]), (1, &[1][..]));
    assert_eq!(spec.sweep.axes["body.columns"], [5, 6]);
}

#[test]
fn errors_name_file_line_key_value_and_the_nearest_key() {
    for (from, to, expected) in [
        (
            "columns = 6",
            "colums = 6",
            "a.toml:3: body.colums = 6: unknown key; the nearest known one is \"body.columns\"",
        ),
        ("[stimuli]", "[stimulus]", "a.toml:9: stimulus: unknown key; the nearest known one is \"stimuli\""),
        (
            "name = \"example\"",
            "name = \"e\"\nspacing = 3.0",
            "a.toml:2: spacing = 3.0: unknown key; the nearest known one is \"body.spacing\"",
        ),
        (
            "bend = 1.0",
            "bent = 1.0",
            "a.toml:8: body.stiffness.bent = 1.0: unknown key; the nearest known one is \"body.stiffness.bend\"",
        ),
        (
            "\"body.columns\" = [5, 6]",
            "\"body.column\" = [5, 6]",
            "a.toml:14: sweep.\"body.column\" = [5, 6]: unknown key; the nearest known one is \"body.columns\"",
        ),
        (
            "\"body.columns\" = [5, 6]",
            "body.columns = [5, 6]",
            "a.toml:14: sweep.body: must not be a table; write an axis in quotes, such as \"body.…\" = [ … ]",
        ),
        (
            "\"body.columns\" = [5, 6]",
            "\"body.columns\" = { from = 5, to = 6 }",
            "a.toml:14: sweep.\"body.columns\": must be a list of values, because it is an axis",
        ),
        (
            "panels = [2]",
            "panel = [2]",
            "a.toml:12: sweep.panel = [2]: unknown key; the nearest known one is \"sweep.panels\"",
        ),
        ("rows = 6", "rows = \"six\"", "a.toml:4: body.rows = \"six\": must be a whole number of at least 0"),
        ("rows = 6", "rows = -6", "a.toml:4: body.rows = -6: must be a whole number of at least 0"),
        (", bend = 1.0", "", "a.toml:8: body.stiffness.bend: must be set; it has no default"),
        ("[stimuli]\nkind = \"bell\"\n", "", "a.toml:1: stimuli: must be set; it has no default"),
        (
            "\"bell\"",
            "\"ball\"",
            "a.toml:10: stimuli.kind = \"ball\": must be \"bell\", \"gauss\", \"irregular\", \"recorded\" or \"mix\"",
        ),
        (
            "columns = 6",
            "columns = \"six\"",
            "a.toml:3: body.columns = \"six\": must be a whole number of at least 0",
        ),
        ("spacing = 15.0", "spacing = -inf", "a.toml:5: body.spacing = -inf: -inf is not a finite number"),
        (
            "\"body.columns\" = [5, 6]",
            "\"body.spacing\" = [15.0, nan]",
            "a.toml:14: sweep.\"body.spacing\" = [15.0, nan]: nan is not a finite number",
        ),
        (
            "rows = 6",
            "clamp = \"top\"",
            "a.toml:4: body.clamp = \"top\": must be \"bottom\", \"ends\", \"sides\", \"hub\", \"none\" or a list of whole numbers of at least 0",
        ),
        (
            "{ stretch = 3.0, shear = 0.5, bend = 1.0 }",
            "3.0",
            "a.toml:8: body.stiffness = 3.0: must be a table { bend, shear, stretch }",
        ),
        (
            "[stimuli]",
            "[sensors]\nnoise = [1.0]\n[stimuli]",
            "a.toml:10: sensors.noise = [1.0]: must be a number or a list of 2 numbers",
        ),
        (
            "[stimuli]",
            "[run]\nniceness = 300\n[stimuli]",
            "a.toml:10: run.niceness = 300: must be a whole number from 0 to 19",
        ),
        (
            "sensors = [1, 2]",
            "sensors = [1.5]",
            "a.toml:13: sweep.sensors = [1.5]: must be a list of whole numbers of at least 0",
        ),
        (
            "rows = 6",
            "design = 7",
            "a.toml:4: body.design = 7: must be a string in quotes, a table { random, spread } or a table { shifts }",
        ),
        (
            "\"body.columns\" = [5, 6]",
            "\"foo\" = [5, 6]",
            "a.toml:14: sweep.foo = [5, 6]: unknown key; an axis is the path of a key in quotes, such as",
        ),
        (
            "panels = [2]",
            "\"sweep.panels\" = [2]",
            "a.toml:12: sweep.\"sweep.panels\" = [2]: belongs to [sweep] itself; write it there without quotes: panels = …",
        ),
        (
            "\"body.columns\" = [5, 6]",
            "\"run.workers\" = [5, 6]",
            "a.toml:14: sweep.\"run.workers\" = [5, 6]: is not a setting of a trial and cannot be swept",
        ),
        (
            "rows = 6",
            "colour = \"red\"",
            "a.toml:4: body.colour = \"red\": unknown key; `metasense setup schema` lists",
        ),
        (
            "rows = 6",
            "rows = 99999999999999999999",
            "a.toml:4: body.rows = 99999999999999999999: is too large",
        ),
        ("rows = 6", "rows = ", "a.toml:4: not valid TOML: "),
        (
            "[stimuli]",
            "[optimise]\nprotocol = 'warm'\n[stimuli]",
            "a.toml:10: optimise.protocol = 'warm': removed: no benefit; use \"joint\"",
        ),
        (
            "\"body.columns\" = [5, 6]",
            "\"body.columns\" = 5",
            "a.toml:14: sweep.\"body.columns\" = 5: must be a list of values, because it is an axis",
        ),
    ] {
        let complaint = complaint(from, to);
        assert!(complaint.starts_with(expected), "{to}:\n{complaint}\n{expected}");
    }
}

fn changed(changes: &[&str]) -> Result<(SweepSpec, Source), String> {
    let changes: Vec<String> = changes.iter().map(|&change| change.to_owned()).collect();
    let source = Source::spec("a.toml", GOOD.to_owned(), &changes).map_err(|e| e.to_string())?;
    Ok((source.parse().map_err(|e| e.to_string())?, source))
}

/// An override equals the same value in the file.
#[test]
fn changes_are_as_if_written() {
    for (change, from, to) in [
        ("body.spacing=16.0", "spacing = 15.0", "spacing = 16.0"),
        ("body.stiffness.bend = 2.5e-1", "bend = 1.0", "bend = 0.25"),
        ("stimuli.kind=irregular", "kind = \"bell\"", "kind = \"irregular\""),
        ("stimuli.kind=\"irregular\"", "kind = \"bell\"", "kind = \"irregular\""),
        ("sweep.seeds=[3, 4]", "[sweep]", "[sweep]\nseeds = [3, 4]"),
        ("sweep.body.columns=[7]", "= [5, 6]", "= [7]"),
        ("sweep.\"body.columns\"=[7]", "= [5, 6]", "= [7]"),
        ("sweep.brain.kind=[cnn, linear]", "[sweep]", "[sweep]\n\"brain.kind\" = [\"cnn\", \"linear\"]"),
        ("body.stiffness={ stretch = 1.0 }", "stretch = 3.0", "stretch = 1.0"),
        ("body.design={ random = 3 }", "rows = 6", "rows = 6\ndesign = { random = 3 }"),
        ("name=other", "name = \"example\"", "name = \"other\""),
        ("body.stiffness=", "stiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }", ""),
        ("sweep.body.columns=", "\"body.columns\" = [5, 6]\n", ""),
        ("sweep.exclude= ", "exclude = [{ sensors = 2, \"body.columns\" = 5 }]", ""),
    ] {
        let (spec, _) = changed(&[change]).unwrap();
        assert!(GOOD.contains(from), "{from}");
        assert_eq!(spec, parse(&GOOD.replacen(from, to, 1)).unwrap(), "{change}");
    }
    let (spec, source) = changed(&["body.rows=5", "run.workers=2"]).unwrap();
    assert_eq!((spec.body.rows, spec.run.workers), (Some(5), Some(2)));
    let (refined, _) = changed(&["body.stiffness={ bend = 2.0 }", "body.stiffness.bend=3.0"]).unwrap();
    assert_eq!(refined.body.stiffness.unwrap().bend, 3.0);
    assert_eq!(parse(&source.text).unwrap(), spec, "the text says all");
    assert_eq!(changed(&[]).unwrap().1.text, GOOD, "without changes it stays as it is");
}

/// A key of a point may be a table, whose keys are checked as elsewhere.
#[test]
fn points_may_hold_tables() {
    let point = |value: &str| GOOD.replace("panels = [2]", &format!("points = [{{ panels = 2, {value} }}]"));
    let spec = parse(&point("\"variation.nodes\" = { scatter = 0.1, correlation = 15.0 }")).unwrap();
    assert_eq!(spec.sweep.points[0]["variation.nodes"]["scatter"], 0.1);
    let refused =
        parse(&point("\"variation.nodes\" = { scatter = 0.1, reach = 15.0 }")).unwrap_err().to_string();
    assert!(refused.contains("\"variation.nodes\".reach = 15.0: unknown key"), "{refused}");
    for value in ["body.columns = 5", "body = { columns = 5 }"] {
        let refused = parse(&point(value)).unwrap_err().to_string();
        let expected = "sweep.points.body: must not be a table; write the path of each key in quotes: \"body.columns\" = 5";
        assert!(refused.ends_with(expected), "{refused}");
    }
}

#[test]
fn errors_of_changes_name_them() {
    for (changes, expected) in [
        (
            &["body.colums=7"][..],
            "command line: body.colums = 7: unknown key; the nearest known one is \"body.columns\"",
        ),
        (
            &["stimuli.recorded.force=[1, -1]"],
            "command line: stimuli.recorded.force = [1, -1]: must be a list of whole numbers of at least 0 or strings in quotes",
        ),
        (&["body.rows=six"], "command line: body.rows = \"six\": must be a whole number of at least 0"),
        (
            &["body.rows=[5, 6]"],
            "command line: body.rows = [5, 6]: must be a whole number of at least 0; write an axis in [sweep]: sweep.\"body.rows\" = [ … ]",
        ),
        (&["body.rows=1", "body.rows=six"], "command line: body.rows = 1: is set twice; leave one out"),
        (
            &["body.stiffness.bend=1", "body.stiffness={ bend = 2 }"],
            "command line: body.stiffness.bend = 1: is set twice; leave one out",
        ),
        (
            &["body.design={ random = 1 }", "body.design={ random = 2 }"],
            "command line: body.design = { random = 1 }: is set twice; leave one out",
        ),
        (&["body.spacing=nan"], "command line: body.spacing = nan: nan is not a finite number"),
        (&["sweep.body.column=[7]"], "command line: sweep.\"body.column\" = [7]: unknown key; the nearest"),
        (
            &["body.stiffness.bend=5", "sweep.body.stiffness=[{ stretch = 1.0, shear = 1.0, bend = 1.0 }]"],
            "command line: body.stiffness.bend = 5: has no effect, because an axis sets the values: sweep.\"body.stiffness\"",
        ),
        (
            &[
                "brain.kind=cnn",
                "sweep.points=[{ \"brain.kind\" = \"linear\" }, { \"brain.kind\" = \"cnn\" }]",
            ],
            "command line: brain.kind = \"cnn\": has no effect, because all entries of sweep.points set it",
        ),
        (
            &["body.columns=7"],
            "command line: body.columns = 7: has no effect, because an axis sets the values: sweep.\"body.columns\" = [ … ]",
        ),
        (
            &["body.rows"],
            "command line: body.rows: must be KEY=VALUE with a value as in a spec, such as optimise",
        ),
        (&["body.row="], "command line: body.row=: the spec does not contain this key"),
        (&["body.rows=", "body.rows=3"], "command line: body.rows = \"\": is set twice; leave one out"),
        (&["="], "command line: =: must be KEY=VALUE"),
        (&["=3"], "command line: =3: must be KEY=VALUE"),
        (&["base=b.toml"], "command line: base=b.toml: can be set only in the spec"),
    ] {
        let complaint = changed(changes).unwrap_err();
        assert!(complaint.starts_with(expected), "{complaint}\n{expected}");
    }
    // also for errors after parsing; keys of the file are still located in the file
    let (_, source) = changed(&["body.rows=5"]).unwrap();
    assert_eq!(source.error("body.rows", "no").to_string(), "command line: body.rows = 5: no");
    assert_eq!(source.error("body.columns", "no").to_string(), "a.toml:14: body.columns = [5, 6]: no");
    assert_eq!(source.error("body.spacing", "no").to_string(), "a.toml:5: body.spacing = 15.0: no");
    let long = source.error("body.spacing", &format!("ends at {:.4} s", 1e300));
    assert_eq!(long.what, "body.spacing = 15.0: ends at 1e300 s");
}

/// Writes files to a temporary folder.
fn files(texts: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in texts {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    folder
}

fn read(folder: &tempfile::TempDir, name: &str) -> Result<Source, SpecError> {
    let file = folder.path().join(name);
    let text = std::fs::read_to_string(&file).unwrap();
    Source::spec(file, text, &[])
}

/// A spec split over three files in two folders equals the spec in one file.
#[test]
fn a_spec_on_a_base_is_as_if_written() {
    let (head, tail) = GOOD.split_once("[stimuli]").unwrap();
    let folder = files(&[
        ("a.toml", &format!("# what it is for\nbase = \"b/b.toml\"\nname = \"example\"\n[stimuli]{tail}")),
        ("b/b.toml", "base = \"c.toml\"\nname = \"b\"\n[body]\nrows = 6\n[sweep]\npanels = [1, 9]\n"),
        ("b/c.toml", &head.replace("rows = 6", "rows = 99")),
    ]);
    let source = read(&folder, "a.toml").unwrap();
    let spec = source.parse().unwrap();
    assert_eq!(spec, parse(GOOD).unwrap());
    assert_eq!(parse(&source.text).unwrap(), spec, "the text says all");
    assert!(source.text.starts_with("# what it is for\n"), "{}", source.text);
    let at = |key: &str| {
        let error = source.error(key, "no");
        format!("{}:{}", error.file.strip_prefix(folder.path()).unwrap().display(), error.line)
    };
    let places = ["body.rows", "body.spacing", "sweep.panels", "name", "body"].map(at);
    assert_eq!(places, ["b/b.toml:4", "b/c.toml:5", "a.toml:7", "a.toml:3", "b/b.toml:3"]);
}

#[test]
fn errors_name_the_file_that_has_the_key() {
    let folder = files(&[
        ("a.toml", "base = \"b.toml\"\n"),
        ("b.toml", &GOOD.replace("rows = 6", "rows = -6")),
        ("c.toml", "base = \"d.toml\"\n[sweep]\npoints = [{ panels = 2 }, { pannels = 3 }]\n"),
        ("d.toml", &GOOD.replace("panels = [2]", "points = [{ panels = 1 }]")),
        ("e.toml", "base = \"f/f.toml\"\n"),
        ("f/f.toml", "[body]\nrows = 6\n\nbase = \"../e.toml\"\n"),
        ("g.toml", "base = \"g.toml\"\n"),
        ("h.toml", "\nbase = \"nowhere.toml\"\n"),
        ("i.toml", "base = 5\n"),
        ("j.toml", "base = \"k.toml\""),
        ("k.toml", "base = \"j.toml\""),
        ("l.toml", "base = \"m.toml\""),
        ("m.toml", "\n[body\n"),
    ]);
    for (file, expected) in [
        ("a.toml", "b.toml:4: body.rows = -6: must be a whole number of at least 0"),
        ("c.toml", "c.toml:3: sweep.points.pannels = 3: unknown key"),
        ("e.toml", "f/f.toml:4: body.base = \"../e.toml\": unknown key"),
        ("g.toml", "g.toml:1: base = \"g.toml\": refers back to a spec that is based on this one"),
        ("h.toml", "h.toml:2: base = \"nowhere.toml\": cannot be read: No such file"),
        ("i.toml", "i.toml:1: base = 5: must be a file name in quotes"),
        ("j.toml", "k.toml:1: base = \"j.toml\": refers back to a spec that is based on this one"),
        ("l.toml", "m.toml:2: not valid TOML: "),
    ] {
        let complaint =
            read(&folder, file).and_then(|source| source.parse::<SweepSpec>()).unwrap_err().to_string();
        let complaint = complaint.strip_prefix(&format!("{}/", folder.path().display())).unwrap();
        assert!(complaint.starts_with(expected), "{complaint}\n{expected}");
    }
}

/// File names in a base are relative to its folder.
#[test]
fn files_are_taken_from_the_folder_of_the_spec_that_names_them() {
    let folder = files(&[
        ("a.toml", "base = \"b/b.toml\"\n[stimuli.recorded]\nfiles = [\"own.npz\"]\n"),
        (
            "b/b.toml",
            "[body]\ndesign = \"x.npy\"\nfile = \"b.toml\"\n[sweep]\n\"body.design\" = [\"y.npy\", { random = 1 }]\n\
             points = [{ \"body.design\" = \"z.npy\" }]\n[stimuli]\nkind = \"x.npy\"\n",
        ),
    ]);
    let table: toml::Table = toml::from_str(&read(&folder, "a.toml").unwrap().text).unwrap();
    let from = folder.path().canonicalize().unwrap();
    let beside = |name: &str| from.join("b").join(name).to_str().unwrap().to_owned();
    assert_eq!(table["body"]["design"].as_str().unwrap(), beside("x.npy"));
    assert_eq!(table["body"]["file"].as_str().unwrap(), beside("b.toml"));
    assert_eq!(table["sweep"]["body.design"][0].as_str().unwrap(), beside("y.npy"));
    assert_eq!(table["sweep"]["points"][0]["body.design"].as_str().unwrap(), beside("z.npy"));
    assert_eq!(table["stimuli"]["recorded"]["files"][0].as_str().unwrap(), "own.npz");
    assert_eq!(table["stimuli"]["kind"].as_str().unwrap(), "x.npy");
}
