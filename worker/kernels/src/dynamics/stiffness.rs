//! Stiffness matrix of the free coordinates: the Hessian of the energy, from products with several directions at once.

use super::Scene;
use super::ligaments::{ShapeCotangent, Turn, product, turns};
use super::model::Model;
use crate::lanes::{Base, Vector};
use faer::sparse::{SparseColMat, Triplet};
use faer::traits::ComplexField;

/// Columns of the matrix that are computed together.
const COLUMNS: usize = <Base as Vector>::LANES;

/// Indices of the coordinates that are not held, among the coordinates of all units.
pub(super) fn unknowns(model: &Model) -> Vec<usize> {
    let inverse = model.inverse_mass.as_flattened();
    (0..inverse.len()).filter(|i| inverse[*i] != 0.0).collect()
}

/// Nonzero entries (row, column, value) of a matrix over the coordinates `unknowns`, by columns, from its products with directions.
pub(super) fn columns(
    unknowns: &[usize],
    units: usize,
    products: impl Fn(&[Vec<f64>]) -> [Vec<f64>; COLUMNS],
) -> Vec<(usize, usize, f64)> {
    let mut entries = Vec::new();
    for (block, columns) in unknowns.chunks(COLUMNS).enumerate() {
        let unit = |&column: &usize| {
            let mut w = vec![0.0; 3 * units];
            w[column] = 1.0;
            w
        };
        let directions: Vec<Vec<f64>> = columns.iter().map(unit).collect();
        for (j, product) in products(&directions)[..columns.len()].iter().enumerate() {
            let rows = unknowns.iter().enumerate().filter(|(_, u)| product[**u] != 0.0);
            entries.extend(rows.map(|(i, u)| (i, COLUMNS * block + j, product[*u])));
        }
    }
    entries
}

/// The sparse n × n matrix with these entries (row, column, value).
pub fn sparse<T: ComplexField>(n: usize, entries: &[(usize, usize, T)]) -> SparseColMat<usize, T> {
    let entries: Vec<_> = entries.iter().map(|(i, j, value)| Triplet::new(*i, *j, value.clone())).collect();
    SparseColMat::try_new_from_triplets(n, n, &entries).expect("entries of an n × n matrix")
}

/// Products of the Hessian of the energy with up to `COLUMNS` directions w, at the state `at`; empty: zero displacement.
pub(super) fn hessian(model: &Model, scene: &Scene, at: &[[f64; 3]], w: &[Vec<f64>]) -> [Vec<f64>; COLUMNS] {
    let zero = Base::splat(0.0);
    let units = model.units();
    let lanes = |i: usize| {
        Base::gather(&std::array::from_fn::<f64, COLUMNS, _>(|lane| w.get(lane).map_or(0.0, |w| w[i])))
    };
    let direction: Vec<[Base; 3]> = (0..units).map(|u| [0, 1, 2].map(|d| lanes(3 * u + d))).collect();
    let mut x = vec![[zero; 3]; units];
    let (mut turn, mut h) = (vec![Turn::NONE; units], x.clone());
    x.iter_mut().zip(at).for_each(|(x, at)| *x = at.map(Base::splat));
    turns::<Base>(&x, &mut turn);
    let (mut arms, mut voids) =
        (vec![[zero; 2]; model.geometry.arms.len()], vec![[zero; 2]; model.ligaments]);
    let kernel = match (scene.linearised, scene.contact.is_some()) {
        (false, false) => product::<Base, false, false, false, false>,
        (false, true) => product::<Base, false, true, false, false>,
        (true, _) => product::<Base, true, true, false, false>,
    };
    let (arms, voids) = (&mut arms[..], &mut voids[..]);
    let shape = ShapeCotangent { arms, voids, stiffness: &mut [], contact: &mut { zero } };
    kernel(model, &model.bars, &x, &direction, &turn, &mut [], &mut h, shape);
    std::array::from_fn(|lane| h.as_flattened().iter().map(|h| -h.lane(lane)).collect())
}
