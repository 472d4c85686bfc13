//! Patterns: the repeated cell of a lattice.
//!
//! A cell contains one or two units; a ligament joins nodes of the same or of different cells. Lengths are in pitches (distance of joined
//! units), nodes in units of h. In square and Kagome lattices, the initial design rotates neighbours in opposite directions. Where three
//! units form a ring, this is impossible; the pattern then rotates all units by the same angle.

/// A node of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct End {
    /// Unit index.
    pub unit: usize,
    /// Index of the node in its unit; in a square 0 right, 1 top, 2 left, 3 bottom.
    pub node: usize,
}

/// A unit of a cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// Reference point in the cell (pitches).
    pub at: [f64; 2],
    /// Nodes, counter-clockwise (units of h).
    pub nodes: Vec<[f64; 2]>,
}

/// The ligaments of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Link {
    /// First end: unit of the cell and node.
    pub from: End,
    /// Second end.
    pub to: End,
    /// Cell of the second end relative to that of the first.
    pub cells: [i32; 2],
}

/// The repeated cell of a lattice.
#[derive(Debug, Clone, PartialEq)]
pub struct Pattern {
    /// Vectors from a cell to the next in i and in j (pitches).
    pub steps: [[f64; 2]; 2],
    /// The units of a cell.
    pub units: Vec<Member>,
    /// Kinds of ligaments.
    pub links: Vec<Link>,
    /// Centre of a largest void in the cell (pitches).
    pub void: [f64; 2],
    turns: Turns,
}

/// Rotation of units in the initial design.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turns {
    /// Opposite in neighbouring cells, as on a chessboard.
    Cells,
    /// Opposite for the two units of a cell.
    Members,
    /// Equal for all units, and already part of the pattern.
    Alike,
}

/// `count` nodes of a regular polygon, the first at the angle `from` (degrees). Nodes on an axis have exact coordinates.
fn regular(count: usize, from: f64) -> Vec<[f64; 2]> {
    // `+ 0.0` turns −0 into 0
    let exact = |x: f64| if (x - x.round()).abs() < 1e-15 { x.round() + 0.0 } else { x };
    let node = |p: usize| {
        let (sin, cos) = (from + 360.0 * p as f64 / count as f64).to_radians().sin_cos();
        [exact(cos), exact(sin)]
    };
    (0..count).map(node).collect()
}

fn link([unit, node]: [usize; 2], [other, at]: [usize; 2], cells: [i32; 2]) -> Link {
    Link { from: End { unit, node }, to: End { unit: other, node: at }, cells }
}

impl Pattern {
    /// Squares, each joined at its corners to four others.
    pub fn square() -> Self {
        Self::squares(0.0, Turns::Cells)
    }

    /// Chiral lattice: squares all rotated by `angle` (rad), with oblique ligaments from corner to corner.
    pub fn chiral(angle: f64) -> Self {
        Self::squares(angle, Turns::Alike)
    }

    fn squares(angle: f64, turns: Turns) -> Self {
        Self {
            steps: [[1.0, 0.0], [0.0, 1.0]],
            units: vec![Member { at: [0.0; 2], nodes: regular(4, angle.to_degrees()) }],
            links: vec![link([0, 0], [0, 2], [1, 0]), link([0, 1], [0, 3], [0, 1])],
            void: [0.5, 0.5],
            turns,
        }
    }

    /// Kagome lattice: triangles that point up and down, each joined at its corners to three others. Six triangles surround a void.
    pub fn kagome() -> Self {
        let (half, third) = (0.5 * 3f64.sqrt(), 1.5);
        Self {
            steps: [[2.0 * half, 0.0], [half, third]],
            units: vec![
                Member { at: [0.0; 2], nodes: regular(3, -30.0) },
                Member { at: [half, -0.5], nodes: regular(3, 30.0) },
            ],
            // from the right, top and left node of a triangle that points up
            links: vec![
                link([0, 0], [1, 1], [0, 0]),
                link([0, 2], [1, 0], [-1, 0]),
                link([0, 1], [1, 2], [-1, 1]),
            ],
            void: [half, 0.5],
            turns: Turns::Members,
        }
    }

    /// Hexagons, each joined at its corners to six others, all rotated by `angle` (rad).
    pub fn triangular(angle: f64) -> Self {
        Self {
            steps: [[1.0, 0.0], [0.5, 0.5 * 3f64.sqrt()]],
            units: vec![Member { at: [0.0; 2], nodes: regular(6, angle.to_degrees()) }],
            links: vec![
                link([0, 0], [0, 3], [1, 0]),
                link([0, 1], [0, 4], [0, 1]),
                link([0, 2], [0, 5], [-1, 1]),
            ],
            void: [0.5, 3f64.sqrt() / 6.0],
            turns: Turns::Alike,
        }
    }

    /// Reference point of a unit (pitches).
    pub fn centre(&self, cell: [i32; 2], member: usize) -> [f64; 2] {
        self.place(cell, self.units[member].at)
    }

    fn place(&self, [i, j]: [i32; 2], at: [f64; 2]) -> [f64; 2] {
        let (i, j) = (f64::from(i), f64::from(j));
        [0, 1].map(|d| i * self.steps[0][d] + j * self.steps[1][d] + at[d])
    }

    /// Cell and index in the cell of unit n in row j of a sheet. With oblique cells, odd rows start half a cell to the right.
    pub fn in_row(&self, j: i32, n: i32) -> ([i32; 2], usize) {
        let back = if self.steps[1][0] == 0.0 { 0 } else { j.div_euclid(2) };
        let count = self.units.len() as i32;
        ([n.div_euclid(count) - back, j], n.rem_euclid(count) as usize)
    }

    /// The units whose reference points lie in a disc of diameter `across`, by cells (j outer, i inner), and the centre of the disc
    /// (pitches): a unit if `across` is odd, the centre of a void if it is even.
    pub fn in_disc(&self, across: i32) -> (Vec<([i32; 2], usize)>, [f64; 2]) {
        let middle = (across - 1).div_euclid(2);
        let centre = self.place([middle; 2], if across % 2 == 0 { self.void } else { self.units[0].at });
        // Squared distances and the squared radius are multiples of 1/12, so the margin 0.01 includes points on the rim despite rounding.
        let most = 0.25 * f64::from(across).powi(2) + 0.01;
        let is_inside = |&(cell, member): &([i32; 2], usize)| {
            let [x, y] = self.centre(cell, member);
            (x - centre[0]).powi(2) + (y - centre[1]).powi(2) < most
        };
        let near = middle - across..=middle + across;
        let members = self.units.len();
        let units = near.clone().flat_map(|j| near.clone().map(move |i| [i, j]));
        let units = units.flat_map(|cell| (0..members).map(move |member| (cell, member)));
        (units.filter(is_inside).collect(), centre)
    }

    /// Sense of a unit's rotation in the initial design: 1, −1 or 0.
    pub fn sense(&self, [i, j]: [i32; 2], member: usize) -> f64 {
        match self.turns {
            Turns::Cells if (i + j).rem_euclid(2) == 0 => 1.0,
            Turns::Members if member == 0 => 1.0,
            Turns::Cells | Turns::Members => -1.0,
            Turns::Alike => 0.0,
        }
    }
}
