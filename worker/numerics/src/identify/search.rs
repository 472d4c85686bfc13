//! Search for the global minimum of F. Waves cause local minima, so a fit begins with a short window of each record and lengthens it. Free
//! parameters are fitted first and alone, from other starts if the misfit becomes large. All other unknowns follow on whole records.

use super::descent::{Descent, How};
use super::objective::{Columns, FitPoint};
use super::unknowns::TRUST;
use super::{Ending, Fit, Parameter, UNEXPLAINED, Unknown, interval};
use crate::dynamics::{Forces, IntegratorSettings};
use nalgebra::DVector;

/// Windows relative to the record, without free parameters.
const WINDOWS: [f64; 5] = [1.0 / 32.0, 0.0625, 0.125, 0.25, 1.0];
/// Growth of the window with free parameters.
const GROWTH: f64 = 1.4;
/// Norm of the two misfits (%) above which a window fails and another start is tried.
const LOST: f64 = 60.0;
/// The same with uncertain clocks, whose offsets can mimic another material.
const LOST_BY_CLOCKS: f64 = 30.0;
/// Factors of other starts on stretch, shear, bend and density.
const SCALES: [f64; 3] = [1.0, 0.5, 2.0];
/// Largest number of other starts, in order of misfit in the first window.
const TRIES: usize = 24;

/// On windows: without free parameters; with them, in the first window and in later ones.
const GLANCE: How = How { rounds: 1, steps: 20, worth: 0.01, close: 0.3 };
const FIRST: How = How { rounds: 4, steps: 4, worth: 0.01, close: 0.3 };
const LATER: How = How { rounds: 2, steps: 4, worth: 0.01, close: 0.3 };
/// On whole records: all unknowns of a trial's twin; free parameters alone; all unknowns of measured records.
const WHOLE: How = How { rounds: 4, steps: 20, worth: 0.0, close: 0.3 };
const ALONE: How = How { rounds: 3, steps: 4, worth: 0.01, close: 0.3 };
const LAST: How = How { close: 0.1, ..WHOLE };

impl Descent<'_> {
    /// Fits all windows in turn. Returns the final point with columns, `Some(None)` if a simulation fails, `None` if stopped.
    pub fn by_windows(&mut self, ending: &mut Ending) -> Option<Option<(FitPoint, Columns)>> {
        let mut z = DVector::zeros(self.objective.unknowns.all().len());
        for part in WINDOWS {
            self.objective.look_at((part * self.objective.instants() as f64).ceil() as usize);
            let Some(point) = self.objective.at(z.clone()) else { break };
            let (point, columns) = self.settle(point, if part < 1.0 { GLANCE } else { WHOLE })?;
            *ending = self.ending;
            if part == 1.0 {
                return Some(columns.map(|columns| (point, columns)));
            }
            z.copy_from(&point.z);
        }
        Some(None)
    }

    /// Fits measured records under `forces`, with intervals.
    pub fn fit(&mut self, fit: &mut Fit, forces: &Forces, asked: &IntegratorSettings, as_scattered: bool) {
        let start = DVector::zeros(self.objective.unknowns.all().len());
        let Some(first) = self.whole(&start) else { return };
        fit.measured.misfit[0] = self.objective.misfit(&first)[1];
        fit.measured.signals[0].clone_from(&first.read);
        fit.ending = Ending::NoProgress;
        let found = match as_scattered {
            true => self.by_windows(&mut fit.ending).expect("told to go on"),
            false => self.free_first(fit, start, forces, asked),
        };
        let Some((point, mut columns)) = found else { return };
        if columns.records.len() < self.objective.readings.counted() {
            columns = self.objective.columns(&point, usize::MAX);
        }
        fit.tell(&self.objective, &point, &columns);
        interval::bound(fit, &self.objective, &point, &columns);
        [fit.measured.residual, fit.measured.misfit[1]] = self.objective.misfit(&point);
        let at_the_bound = fit.estimates.iter().any(|e| e.at_the_bound)
            || fit.offsets.iter().flatten().any(|offset| offset.half.is_none());
        // A bound or an undetermined direction is the more specific cause.
        if at_the_bound {
            fit.ending = Ending::AtTheBound;
        } else if !fit.undetermined.is_empty() && fit.ending == Ending::Converged {
            fit.ending = Ending::NotIdentifiable;
        } else if fit.measured.misfit[1].iter().any(|left| *left > UNEXPLAINED) {
            fit.ending = Ending::NotExplained;
        }
        fit.measured.signals[1] = point.read;
    }

    /// Fits windows from one start after another until one succeeds; then free parameters alone on whole records, then all unknowns.
    fn free_first(
        &mut self,
        fit: &mut Fit,
        start: DVector<f64>,
        forces: &Forces,
        asked: &IntegratorSettings,
    ) -> Option<(FitPoint, Columns)> {
        let all = start.len();
        self.objective.moves = self.objective.unknowns.free();
        let (mut best, mut farthest) = (start.clone(), (0, f64::INFINITY));
        let mut starts = vec![start.clone()];
        for tried in 0..=TRIES {
            let Some(from) = starts.get(tried) else { break };
            let (found, (window, misfit)) = self.lengthen(from.clone());
            if window > farthest.0 || (window == farthest.0 && misfit < farthest.1) {
                (best, farthest) = (found, (window, misfit));
            }
            if misfit < self.lost() {
                break;
            }
            if tried == 0 {
                starts.extend(self.others(&start));
            }
        }
        fit.measured.solver = self.objective.tune(&best, forces, asked);
        let point = self.whole(&best)?;
        let (point, _) = self.settle(point, ALONE)?;
        self.objective.moves = all;
        let (point, columns) = self.settle(point, LAST)?;
        fit.ending = self.ending;
        columns.map(|columns| (point, columns))
    }

    /// Lengthens the window until it covers the record or fails. Returns z, the last window and its misfit.
    fn lengthen(&mut self, mut z: DVector<f64>) -> (DVector<f64>, (usize, f64)) {
        let (mut window, mut how) = (self.objective.first_window(), FIRST);
        while window < self.objective.instants() {
            self.objective.look_at(window);
            let Some(point) = self.objective.at(z.clone()) else { return (z, (window, f64::INFINITY)) };
            let (point, _) = self.settle(point, how).expect("told to go on");
            z.copy_from(&point.z);
            let misfit = self.size(&point);
            if misfit > self.lost() {
                return (z, (window, misfit));
            }
            window = ((window as f64 * GROWTH).ceil() as usize).max(window + 1);
            how = LATER;
        }
        (z, (window, 0.0))
    }

    fn lost(&self) -> f64 {
        if self.objective.clock.is_some() { LOST_BY_CLOCKS } else { LOST }
    }

    fn size(&self, point: &FitPoint) -> f64 {
        let [a, b] = self.objective.misfit(point)[1];
        a.hypot(b)
    }

    /// Starts with all combinations of `SCALES` on the free parameters, in order of misfit in the first window.
    fn others(&mut self, start: &DVector<f64>) -> Vec<DVector<f64>> {
        self.objective.look_at(self.objective.first_window());
        let unknowns = self.objective.unknowns.all();
        let places = [Parameter::Stretch, Parameter::Shear, Parameter::Bend, Parameter::Density]
            .map(|parameter| unknowns.iter().position(|of| *of == Unknown::Material(parameter)));
        let mut others = Vec::new();
        for n in 1..81usize {
            let scales = [n / 27, n / 9 % 3, n / 3 % 3, n % 3].map(|k| SCALES[k]);
            if places.iter().zip(scales).any(|(place, scale)| place.is_none() && scale != 1.0) {
                continue;
            }
            let mut there = start.clone();
            places.iter().zip(scales).for_each(|(place, scale)| {
                if let Some(k) = place {
                    there[*k] += scale.ln() / TRUST;
                }
            });
            if let Some(point) = self.objective.at(there.clone()) {
                others.push((self.size(&point), there));
            }
        }
        others.sort_by(|a, b| a.0.total_cmp(&b.0));
        others.into_iter().map(|other| other.1).collect()
    }

    fn whole(&mut self, z: &DVector<f64>) -> Option<FitPoint> {
        self.objective.look_at(self.objective.instants());
        self.objective.at(z.clone())
    }
}
