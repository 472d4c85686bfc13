//! The contents of the files that a spec names, so that the hash of a trial depends on the contents.

use std::error::Error as _;
use std::path::Path;

use metasense_schemas::spec::{Design, Lattice, LayoutKind, Own, Stimuli, SweepSpec};
use metasense_source::{Source, SpecError};
use metasense_worker::design::{self, DesignError, Layout};
use metasense_worker::problem;
use metasense_worker::{external, polygons, records};

use super::check::distinct;
use super::located;

/// Advice about a file that does not exist.
fn from_where(path: &Path) -> &'static str {
    if path.exists() { "" } else { "; file names are relative to the folder of the spec" }
}

/// What `read` finds in a file that a key of the body names.
fn read_file<T>(
    key: &str,
    file: &Path,
    source: &Source,
    read: impl FnOnce(&Path) -> Result<T, DesignError>,
) -> Result<T, SpecError> {
    let path = source.folder().join(file);
    read(&path).map_err(|error| {
        let because = error.source().map_or(String::new(), |cause| format!(": {cause}{}", from_where(&path)));
        source.error_with(key, Some(&format!("{file:?}")), &format!("{error}{because}"))
    })
}

/// The spec with the polygons of its body's file and their mean lengths, so that the trial's hash depends on the content.
pub(crate) fn with_file(spec: &SweepSpec, source: &Source) -> Result<SweepSpec, SpecError> {
    let mut spec = spec.clone();
    let body = &mut spec.body;
    let Some(own) = body.file.take() else { return Ok(spec) };
    let others = [
        ("body.columns", body.columns.is_some()),
        ("body.rows", body.rows.is_some()),
        ("body.spacing", body.spacing.is_some()),
        ("body.ligament_length", body.ligament_length.is_some()),
        ("body.width", body.width.is_some()),
        ("body.diameter", body.diameter.is_some()),
        ("body.lattice", body.lattice != Lattice::Square),
        ("body.layout", body.layout != LayoutKind::Planar),
        ("optimise.tie", spec.optimise.tie.is_some()),
    ];
    if let Some((key, _)) = others.into_iter().find(|(_, given)| *given) {
        return Err(source.error(key, "cannot be set together with body.file"));
    }
    let (given, name) = match own {
        Own::Given(given) => (given, String::new()),
        Own::File(file) => (read_file("body.file", &file, source, polygons::read)?, format!("{file:?}, ")),
    };
    body.file = Some(Own::Given(given));
    let layout =
        problem::layout(body).map_err(|e| source.error_with(&e.key, Some(&(name + &e.value)), &e.remedy))?;
    (body.spacing, body.ligament_length) = (Some(layout.spacing), Some(layout.ligament_length));
    Ok(spec)
}

/// The spec of an external body with what its program describes, and its design.
pub(super) fn described(spec: &SweepSpec, source: &Source) -> Result<SweepSpec, SpecError> {
    let (mut spec, folder) = (spec.clone(), source.folder());
    for word in &mut spec.body.command {
        // a link stays one: an interpreter of a virtual environment is told by where it lies
        let file = std::path::absolute(folder.join(&*word)).ok().filter(|file| file.is_file());
        if let Some(path) = file.as_deref().and_then(Path::to_str) {
            path.clone_into(word);
        }
    }
    let (command, limit) = (&spec.body.command, spec.body.time_limit);
    let asked = external::describe(command, limit);
    let description = asked.map_err(|fault| source.error("body.command", &fault.detail))?;
    if let Some(Design::File(file)) = &spec.body.design {
        let read = |path: &Path| design::read_array(path, description.alpha.len());
        let shifts = read_file("body.design", file, source, read)?;
        spec.body.design = Some(Design::Shifts { shifts });
    }
    problem::external::described(&spec, description).map_err(located(source))
}

/// A design with the content of its file, so that the trial's hash depends on the content; other designs unchanged.
pub(crate) fn with_design(
    key: &str,
    design: Option<Design>,
    layout: &Layout,
    source: &Source,
) -> Result<Option<Design>, SpecError> {
    let Some(Design::File(file)) = design else { return Ok(design) };
    let shifts = read_file(key, &file, source, |path| design::read(path, layout))?;
    Ok(Some(Design::Shifts { shifts }))
}

/// The stimuli with absolute paths of their records, for workers, and the digest of the contents.
pub(super) fn with_records(mut stimuli: Stimuli, source: &Source) -> Result<Stimuli, SpecError> {
    if let Some(recorded) = &mut stimuli.recorded {
        for file in &mut recorded.files {
            let path = source.folder().join(&*file);
            let fault = |e: std::io::Error| {
                let remedy = format!("cannot be read: {e}{}", from_where(&path));
                source.error_with("stimuli.recorded.files", Some(&format!("{file:?}")), &remedy)
            };
            *file = path.canonicalize().map_err(fault)?;
            if file.to_str().is_none() {
                let shown = file.display().to_string();
                return Err(source.error_with("stimuli.recorded.files", Some(&shown), "must be UTF-8"));
            }
        }
        distinct(&recorded.files, "stimuli.recorded.files", source)?;
        let digest = records::digest(recorded).map_err(located(source))?;
        recorded.digest.get_or_insert(digest);
    }
    Ok(stimuli)
}
