//! The way to the least of F. A wave's phase makes F hilly, so a fit begins with the first part of each record and lengthens it. Free
//! parameters go first and alone; where a window loses the records, from another start. What else scatters follows on the whole records.

use super::descent::{Descent, How};
use super::objective::{Columns, Point};
use super::{Ending, Fit, Parameter, UNEXPLAINED, Unknown, interval};
use crate::dynamics::{Forces, Solver};
use nalgebra::DVector;

/// Parts of the records that are looked at, one after the other, where no parameter is free.
const WINDOWS: [f64; 5] = [1.0 / 32.0, 0.0625, 0.125, 0.25, 1.0];
/// By how much a window is lengthened where some are.
const GROWTH: f64 = 1.4;
/// Root of the sum of the squared misfits (%) of both kinds from which a window is lost: another start is tried.
const LOST: f64 = 60.0;
/// The same where clocks may be off: their offsets explain much of the signals of another material.
const LOST_BY_CLOCKS: f64 = 30.0;
/// Factors of other starts, on stretch, shear, bend and density.
const SCALES: [f64; 3] = [1.0, 0.5, 2.0];
/// Other starts that are tried, those of least misfit in the first window first.
const TRIES: usize = 24;

/// On parts of the records, and there for free parameters, first and later.
const GLANCE: How = How { rounds: 1, steps: 20, worth: 0.01, close: 0.3 };
const FIRST: How = How { rounds: 4, steps: 4, worth: 0.01, close: 0.3 };
const LATER: How = How { rounds: 2, steps: 4, worth: 0.01, close: 0.3 };
/// On whole records: of twins in trials; of free parameters alone, and of all unknowns.
const WHOLE: How = How { rounds: 4, steps: 20, worth: 0.0, close: 0.3 };
const ALONE: How = How { rounds: 3, steps: 4, worth: 0.01, close: 0.3 };
const LAST: How = How { close: 0.1, ..WHOLE };

impl Descent<'_> {
    /// Through the windows: where that led, and columns near there.
    pub fn by_windows(&mut self, ending: &mut Ending) -> Option<Option<(Point, Columns)>> {
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

    /// Fits measured records under `forces`, and says how well what was found is known.
    pub fn fit(&mut self, fit: &mut Fit, forces: &Forces, asked: &Solver, as_scattered: bool) {
        let start = DVector::zeros(self.objective.unknowns.all().len());
        let Some(first) = self.whole(&start) else { return };
        fit.misfit[0] = self.objective.misfit(&first)[1];
        fit.signals[0].clone_from(&first.read);
        fit.ending = Ending::NoProgress;
        let found = match as_scattered {
            true => self.by_windows(&mut fit.ending).expect("told to go on"),
            false => self.free_first(fit, start, forces, asked),
        };
        let Some((point, mut columns)) = found else { return };
        if columns.records.len() < self.objective.counted() {
            columns = self.objective.columns(&point, usize::MAX);
        }
        fit.tell(&self.objective, &point, &columns);
        interval::bound(fit, &self.objective, &point, &columns);
        [fit.residual, fit.misfit[1]] = self.objective.misfit(&point);
        let at_the_bound = fit.estimates.iter().any(|e| e.at_the_bound)
            || fit.offsets.iter().flatten().any(|offset| offset.half.is_none());
        // what is at the bound or undetermined is the nearer cause
        if at_the_bound {
            fit.ending = Ending::AtTheBound;
        } else if !fit.undetermined.is_empty() && fit.ending == Ending::Converged {
            fit.ending = Ending::NotIdentifiable;
        } else if fit.misfit[1].iter().any(|left| *left > UNEXPLAINED) {
            fit.ending = Ending::NotExplained;
        }
        fit.signals[1] = point.read;
    }

    /// Window after window from one start after the other until one stays with the records; then free parameters, then all unknowns.
    fn free_first(
        &mut self,
        fit: &mut Fit,
        start: DVector<f64>,
        forces: &Forces,
        asked: &Solver,
    ) -> Option<(Point, Columns)> {
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
        fit.solver = self.objective.tune(&best, forces, asked);
        let point = self.whole(&best)?;
        let (point, _) = self.settle(point, ALONE)?;
        self.objective.moves = all;
        let (point, columns) = self.settle(point, LAST)?;
        fit.ending = self.ending;
        columns.map(|columns| (point, columns))
    }

    /// From the first window on until the whole record is looked at or lost: what was found, the last window and its misfit.
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
        if self.objective.has_clocks() { LOST_BY_CLOCKS } else { LOST }
    }

    fn size(&self, point: &Point) -> f64 {
        let [a, b] = self.objective.misfit(point)[1];
        a.hypot(b)
    }

    /// All combinations of `SCALES` on the start, but of those that would move what is held; those of least misfit in the first window first.
    fn others(&mut self, start: &DVector<f64>) -> Vec<DVector<f64>> {
        self.objective.look_at(self.objective.first_window());
        let unknowns = self.objective.unknowns.all();
        let places = [Parameter::Stretch, Parameter::Shear, Parameter::Bend, Parameter::Density]
            .map(|parameter| unknowns.iter().position(|of| *of == Unknown::Material(parameter)));
        let log = self.objective.unknowns.log();
        let mut others = Vec::new();
        for n in 1..81usize {
            let scales = [n / 27, n / 9 % 3, n / 3 % 3, n % 3].map(|k| SCALES[k]);
            if places.iter().zip(scales).any(|(place, scale)| place.is_none() && scale != 1.0) {
                continue;
            }
            let mut there = start.clone();
            places.iter().zip(scales).for_each(|(place, scale)| {
                if let Some(k) = place {
                    there[*k] += scale.ln() / log;
                }
            });
            if let Some(point) = self.objective.at(there.clone()) {
                others.push((self.size(&point), there));
            }
        }
        others.sort_by(|a, b| a.0.total_cmp(&b.0));
        others.into_iter().map(|other| other.1).collect()
    }

    fn whole(&mut self, z: &DVector<f64>) -> Option<Point> {
        self.objective.look_at(self.objective.instants());
        self.objective.at(z.clone())
    }
}
