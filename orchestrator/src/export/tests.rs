//! A body for tests of exports.

use metasense_lab::replay::{Drawing, Panel};

/// 3 × 3 squares rotated by 20°, pitch 15 mm, ligaments 2.25 mm long.
pub fn squares() -> Drawing {
    squares_moved(|_, _| [0.0; 2])
}

/// The same body with moved joints: two corners and the ligament between them. The joint right of unit u moves by `shift(u, 0)`,
/// the joint above it by `shift(u, 1)`; free corners stay.
pub fn squares_moved(shift: impl Fn(usize, usize) -> [f64; 2]) -> Drawing {
    let (n, pitch, half) = (3usize, 15.0, 6.375);
    let mut units = Vec::new();
    let mut joints = Vec::new();
    for j in 0..n {
        for i in 0..n {
            let angle = 20f64.to_radians() * if (i + j) % 2 == 0 { 1.0 } else { -1.0 };
            let corner = |p: usize| {
                let turn = angle + p as f64 * std::f64::consts::FRAC_PI_2;
                let radius = half / angle.cos();
                [i as f64 * pitch + radius * turn.cos(), j as f64 * pitch + radius * turn.sin()]
            };
            units.push((0..4).map(corner).collect::<Vec<_>>());
            if i + 1 < n {
                joints.push([(j * n + i, 0), (j * n + i + 1, 2)]);
            }
            if j + 1 < n {
                joints.push([(j * n + i, 1), (j * n + n + i, 3)]);
            }
        }
    }
    for &[(u, p), other] in &joints {
        let [x, y] = shift(u, p);
        for (unit, corner) in [(u, p), other] {
            let [cx, cy]: [f64; 2] = units[unit][corner];
            units[unit][corner] = [cx + x, cy + y];
        }
    }
    let corner = |(u, p): (usize, usize)| units[u][p];
    let ligaments = joints.iter().map(|&[a, b]| [corner(a), corner(b)]).collect();
    let centroids = (0..n * n).map(|u| [(u % n) as f64 * pitch, (u / n) as f64 * pitch]).collect();
    Drawing {
        ligaments,
        joints,
        centroids,
        panels: vec![(Panel::central(7, [0.0, -1.0]), [0.0; 2])],
        sensors: vec![4],
        clamped: vec![0, 1, 2],
        guided: vec![],
        active: vec![],
        spacing: pitch,
        clock: vec![],
        units,
    }
}
