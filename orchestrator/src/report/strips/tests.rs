use super::*;

/// A blow from 0.4 to 0.5 s has a second plot of its time; a force over the whole record has none, and histories that estimate
/// nothing have no residual. The tick of forces that are never positive is negative.
#[test]
fn estimates_have_residuals_and_a_plot_of_the_blows() {
    let curve = |force: &dyn Fn(f64) -> f64| -> Vec<Curve> {
        vec![(1..=100).map(|n| 0.01 * f64::from(n)).map(|t| (t, force(t))).collect()]
    };
    let drawn = |force: &dyn Fn(f64) -> f64, estimates| {
        let sources = [("truth", curve(force)), ("optimised", curve(&|t| force(t) + 0.1))];
        let sources = sources.map(|(class, curves)| (class.to_owned(), curves)).into();
        let strip = Strip { title: "sample 3".into(), sources, bands: vec![] };
        strips(&[strip], &["panel 0".into()], " N", 1.0, estimates).0
    };
    let blow = |t: f64| if (0.395..0.505).contains(&t) { 2.0 } else { 0.0 };
    let pictures = drawn(&blow, true);
    assert!(pictures.iter().all(|picture| picture.marks.0.contains(">residual<")));
    let [whole, near] = &pictures[..] else { panic!("{} plots", pictures.len()) };
    assert!(whole.marks.0.contains(">0<") && !near.marks.0.contains(">0<"), "{near:?}");
    assert_eq!(drawn(&|_| 1.0, true).len(), 1);
    let plain = drawn(&blow, false);
    assert!(plain.len() == 1 && !plain[0].marks.0.contains(">residual<"));
    let pulled = drawn(&|t| -0.25 * blow(t), false);
    assert!(pulled[0].marks.0.contains(">-0.2 N<"), "{pulled:?}");
}
