//! Removed keys and values. A spec that contains one is rejected with the message in this table.

/// Key, removed value (`None`: the whole key), and message.
const REMOVED: &[(&str, Option<&str>, &str)] = &[
    ("body.hinge", None, "removed: ligaments have a linear bending stiffness; delete this key"),
    ("body.panel_angle", None, "removed: body.panels = [{ unit = 34, direction = [1, 0] }] turns a force"),
    ("feasible.keep_clamped", None, "removed: no spec used it; list the units in optimise.frozen"),
    ("feasible.keep_panels", None, "removed: no spec used it; list the units in optimise.frozen"),
    ("optimise.curvature", None, "removed: it improved no body; delete this key"),
    ("optimise.damping", None, "removed with optimise.curvature; delete this key"),
    ("optimise.gradient", Some("implicit_only"), "removed: no gradient by itself; use \"implicit\""),
    ("optimise.placement", None, "removed: no benefit; sensors stay where sensors.search puts them"),
    ("optimise.protocol", Some("cmaes"), "removed: no benefit; use \"joint\" (or \"random\" as a baseline)"),
    ("optimise.protocol", Some("envelope"), "removed: \"joint\" has less error in half the time; use it"),
    ("optimise.protocol", Some("warm"), "removed: no benefit; use \"joint\""),
    ("run.prune", None, "removed: keeping the better seeds biased all intervals; delete this key"),
    ("sensors.search", Some("d_optimal"), "removed: no benefit; use \"greedy\""),
    ("sensors.search", Some("pivots"), "removed: no benefit; use \"greedy\""),
    ("solver.method", Some("implicit"), "removed: \"auto\" was cheaper in every scene; use \"auto\""),
    ("optimise.coarse.method", Some("implicit"), "removed: \"auto\" was always cheaper; use \"auto\""),
];

/// Returns the message for a key, or for its value as written, if it was removed.
pub fn removed(key: &str, value: &str) -> Option<&'static str> {
    let is = |name: &str| key.strip_prefix(name).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
    let written =
        |given: &str| ['"', '\''].iter().any(|quote| value.contains(&format!("{quote}{given}{quote}")));
    let has_value = |given: Option<&str>| given.is_none_or(written);
    REMOVED.iter().find(|(name, given, _)| is(name) && has_value(*given)).map(|(.., why)| *why)
}
