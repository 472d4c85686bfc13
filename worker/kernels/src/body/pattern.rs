//! Patterns: what a lattice repeats.
//!
//! A cell holds one unit, or two; ligaments lead from a node to one of the same or another cell. Lengths are in pitches, the distance
//! of joined units, and of nodes in units of h. Where neighbours turn against each other (squares, Kagome's triangles) the initial
//! design does so; where three units meet in a ring they cannot, and the pattern's units are turned alike instead.

/// A node of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct End {
    /// Unit index.
    pub unit: usize,
    /// Its place among the unit's nodes; of a square 0 right, 1 top, 2 left, 3 bottom.
    pub node: usize,
}

/// A unit of a cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// Where it is in the cell (pitches).
    pub at: [f64; 2],
    /// Its nodes, counter-clockwise.
    pub nodes: Vec<[f64; 2]>,
}

/// The ligaments of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Link {
    /// Unit of the cell and node where they begin.
    pub from: End,
    /// Where they end.
    pub to: End,
    /// In which cell, from the one where they begin.
    pub cells: [i32; 2],
}

/// What a lattice repeats.
#[derive(Debug, Clone, PartialEq)]
pub struct Pattern {
    /// From a cell to the next in i, and in j (pitches).
    pub steps: [[f64; 2]; 2],
    /// The units of a cell.
    pub units: Vec<Member>,
    /// Ligaments, by kind.
    pub links: Vec<Link>,
    /// Where the middle of a void is in the cell (pitches), of the largest ones.
    pub void: [f64; 2],
    /// How units turn in the initial design.
    turns: Turns,
}

/// How units turn in the initial design.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turns {
    /// As on a chessboard.
    Cells,
    /// The units of a cell one against the other.
    Members,
    /// Alike, which is in the pattern.
    Alike,
}

/// `count` nodes of a regular polygon, the first at an angle (degrees); nodes on an axis lie on it to the bit.
fn regular(count: usize, from: f64) -> Vec<[f64; 2]> {
    let exact = |x: f64| {
        if x.abs() < 1e-15 {
            0.0
        } else if (x.abs() - 1.0).abs() < 1e-15 {
            x.signum()
        } else {
            x
        }
    };
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
    /// Squares, each joined to four others at its corners.
    pub fn square() -> Self {
        Self::squares(0.0, Turns::Cells)
    }

    /// Squares that all turn by one angle (rad), so that ligaments lead aslant from corner to corner: a chiral lattice.
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

    /// Triangles that point up and down, each joined to three others at its corners, around voids of six.
    pub fn kagome() -> Self {
        let (half, third) = (0.5 * 3f64.sqrt(), 1.5);
        Self {
            steps: [[2.0 * half, 0.0], [half, third]],
            units: vec![
                Member { at: [0.0; 2], nodes: regular(3, -30.0) },
                Member { at: [half, -0.5], nodes: regular(3, 30.0) },
            ],
            // from the right, the top and the left node of one that points up
            links: vec![
                link([0, 0], [1, 1], [0, 0]),
                link([0, 2], [1, 0], [-1, 0]),
                link([0, 1], [1, 2], [-1, 1]),
            ],
            void: [half, 0.5],
            turns: Turns::Members,
        }
    }

    /// Hexagons, each joined to six others at its corners, all turned by one angle (rad).
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

    /// Where a unit of a cell is (pitches).
    pub fn centre(&self, cell: [i32; 2], member: usize) -> [f64; 2] {
        self.place(cell, self.units[member].at)
    }

    fn place(&self, [i, j]: [i32; 2], at: [f64; 2]) -> [f64; 2] {
        let (i, j) = (f64::from(i), f64::from(j));
        [0, 1].map(|d| i * self.steps[0][d] + j * self.steps[1][d] + at[d])
    }

    /// Unit n of row j of a sheet, from the left: its cell and its place there. Odd rows of slanting cells are half a cell to the right.
    pub fn in_row(&self, j: i32, n: i32) -> ([i32; 2], usize) {
        let back = if self.steps[1][0] == 0.0 { 0 } else { j.div_euclid(2) };
        let count = self.units.len() as i32;
        ([n.div_euclid(count) - back, j], n.rem_euclid(count) as usize)
    }

    /// The units whose reference points lie in a disc, by cells (j outer, i inner), and its centre (pitches): where the diameter `across` is odd
    /// at a unit, where it is even in the middle of a void.
    pub fn in_disc(&self, across: i32) -> (Vec<([i32; 2], usize)>, [f64; 2]) {
        let middle = (across - 1).div_euclid(2);
        let centre = self.place([middle; 2], if across % 2 == 0 { self.void } else { self.units[0].at });
        // Squares of distances and of the radius are multiples of a twelfth: what lies on the rim is inside, whatever rounding says.
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

    /// Which way a unit of a cell turns in the initial design, or 0.
    pub fn sense(&self, [i, j]: [i32; 2], member: usize) -> f64 {
        match self.turns {
            Turns::Cells if (i + j).rem_euclid(2) == 0 => 1.0,
            Turns::Members if member == 0 => 1.0,
            Turns::Cells | Turns::Members => -1.0,
            Turns::Alike => 0.0,
        }
    }
}
