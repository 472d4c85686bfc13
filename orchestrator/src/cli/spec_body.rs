//! The body of a spec or a trial, for commands about designs.

use metasense_schemas::spec::{Body, SweepSpec, TrialSpec};
use metasense_source::{Source, SpecError};
use metasense_worker::design::{FeasibleSet, Layout, Limits};
use metasense_worker::problem::{self, Invalid, Panel};

use crate::plan::{check_placements, combinations, layout, located, placement, with_design, with_file};

/// A single body of a spec, for commands about designs rather than trials.
pub struct SpecBody {
    pub layout: Layout,
    pub limits: Limits,
    /// Feasible designs; `None` if the trials of the sweep move the body in different ways.
    pub castable: Option<FeasibleSet>,
    /// The initial design; it may be infeasible.
    pub initial: Vec<f64>,
    pub clamped: Vec<usize>,
    /// Units that are partly held.
    pub guided: Vec<usize>,
    /// Input panels for the first K of the sweep.
    pub panels: Vec<Panel>,
    /// Sensor units of the first placement for the first M of the sweep.
    pub sensors: Vec<usize>,
}

impl SpecBody {
    /// The body of a spec; `None` if the sweep has several.
    ///
    /// # Errors
    /// For the first key that is unknown or has an impossible value.
    pub fn new(source: &Source) -> Result<Option<Self>, SpecError> {
        let sweep: SweepSpec = source.parse()?;
        let located = located(source);
        problem::external::polygons(&sweep.body).map_err(located)?;
        let mut combinations = combinations(&sweep, source)?;
        let first = combinations.swap_remove(0).spec;
        let other = |spec: &SweepSpec| spec.body != first.body || spec.feasible != first.feasible;
        if combinations.iter().any(|c| other(&c.spec)) {
            return Ok(None);
        }
        let (first, _) = problem::scale_to_size(&with_file(&first, source)?).map_err(located)?;
        let layout = layout(&first.body).map_err(located)?;
        let design = with_design("body.design", first.body.design.clone(), &layout, source)?;
        let body = Body { design, ..first.body.clone() };
        let limits = problem::limits(&first.feasible).map_err(located)?;
        let initial = problem::initial_design(&body, &layout, limits).map_err(located)?;
        let clamped = problem::clamped(&body, &layout).map_err(located)?;
        let panels = first.sweep.panels.first().copied().unwrap_or(0);
        let sensors = first.sweep.sensors.first().copied().unwrap_or(0);
        let placed = match &first.sensors.placements {
            Some(lists) => {
                check_placements(lists, source)?;
                let units = lists.iter().find(|list| list.len() == sensors).cloned().unwrap_or_default();
                problem::check_units("sensors.placements", &units, &layout, &clamped).map_err(located)?
            }
            None => placement(&body, &layout, 0, &clamped).into_iter().take(sensors).collect(),
        };
        let units = match panels {
            0 => Vec::new(),
            _ => problem::panel_units(&body, &layout, panels).map_err(located)?,
        };
        let held = problem::held(&body, &layout).map_err(located)?;
        let moves = |spec: &SweepSpec| {
            let mut frozen = spec.optimise.frozen.clone().unwrap_or_default();
            frozen.sort_unstable();
            (spec.optimise.tie.unwrap_or([1, 1]), frozen)
        };
        let moves_alike = combinations.iter().all(|c| moves(&c.spec) == moves(&first));
        let castable = problem::castable(&first.optimise, &layout, limits).map_err(located)?;
        Ok(Some(Self {
            castable: moves_alike.then_some(castable),
            limits,
            initial,
            guided: held[clamped.len()..].to_vec(),
            clamped,
            panels: problem::panels(&body, &units, &layout),
            sensors: placed,
            layout,
        }))
    }

    /// The body of a trial.
    ///
    /// # Errors
    /// If the values are impossible; the trials of a plan are valid.
    pub fn of_trial(trial: &TrialSpec) -> Result<Self, Invalid> {
        problem::external::polygons(&trial.body)?;
        let layout = problem::layout(&trial.body)?;
        let limits = problem::limits(&trial.feasible)?;
        let (clamped, held) = (problem::clamped(&trial.body, &layout)?, problem::held(&trial.body, &layout)?);
        Ok(Self {
            castable: Some(problem::castable(&trial.optimise, &layout, limits)?),
            limits,
            initial: problem::initial_design(&trial.body, &layout, limits)?,
            guided: held[clamped.len()..].to_vec(),
            clamped,
            panels: problem::panels(&trial.body, &trial.panel_units, &layout),
            sensors: trial.sensor_units.clone(),
            layout,
        })
    }
}
