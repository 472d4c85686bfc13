use super::*;

/// One end clamped, the other loaded by (N, V, M). Deflections follow from compliances (unit loads: stretch N l/EA, bending V
/// l³/3EI + M l²/2EI and V l²/2EI + M l/EI, shear V l/κGA). The work of the loads equals the model's energy.
#[test]
fn the_energy_of_a_ligament_is_the_work_that_bends_a_timoshenko_beam() {
    for (width, length) in [(0.5, 4.0), (2.0, 2.25), (5.0, 3.0)] {
        let ligament = LigamentMaterial { modulus: 0.26, thickness: 10.0, width, length };
        let (young, shear) = (0.26, 0.26 / 3.0);
        let (area, moment) = (10.0 * width, 10.0 * width.powi(3) / 12.0);
        for [n, v, m] in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.3, -0.7, 0.4]] {
            let along = n * length / (young * area);
            let slant = v * length / (6.0 / 7.0 * shear * area);
            let ei = young * moment;
            let across = (v * length / 3.0 + m / 2.0) * length * length / ei + slant;
            let turn = (v * length / 2.0 + m) * length / ei;
            let work = 0.5 * (n * along + v * across + m * turn);
            let k = ligament.stiffness();
            let energy = 0.5 * k.stretch * along * along
                + 0.5 * k.shear * (across - 0.5 * length * turn).powi(2)
                + 0.5 * k.bend * turn * turn;
            assert!(
                (energy / work - 1.0).abs() < 1e-12,
                "w = {width}, l = {length}: {energy} against {work}"
            );
        }
    }
}

/// A ligament follows from its own stiffnesses. Gent's formula gives 2.45 MPa at Shore A 50; 0.26 MPa is about Shore A 4.
#[test]
fn stiffnesses_have_their_ligament_and_a_modulus_its_hardness() {
    let own = LigamentMaterial { modulus: 0.26, thickness: 8.0, width: 1.5, length: 4.0 };
    let found = LigamentMaterial::of(&own.stiffness(), 4.0, 8.0);
    assert!((found.width / 1.5 - 1.0).abs() < 1e-12 && (found.modulus / 0.26 - 1.0).abs() < 1e-12);
    assert!((shore_a(2.4558) - 50.0).abs() < 0.1, "{}", shore_a(2.4558));
    assert!(shore_a(0.15) < 0.0 && shore_a(0.26) > 3.0);
}

/// MODEL.md's reference body does not follow these formulas, but its three stiffnesses are within a quarter of those of one
/// ligament, 2 mm wide with E t = 3.375 N/mm.
#[test]
fn the_reference_body_s_ligaments_are_some_two_millimetres_wide() {
    let k = LigamentMaterial { modulus: 0.3375, thickness: 10.0, width: 2.0, length: 2.25 }.stiffness();
    let own = [k.stretch, k.shear, k.bend];
    for (own, reference) in own.into_iter().zip([3.0, 0.5, 1.0]) {
        assert!((own / reference).ln().abs() < 0.25, "{own} against {reference}: {k:?}");
    }
}
