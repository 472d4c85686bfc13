//! What training gains in the scenes of the paper's authors.

use super::rows::{Row, geometric, number, of, rows, short, with_interval};
use super::table;

/// A line per setting, in the order of the rows: geometric means of the errors of the initial and of the trained body, and their
/// ratio with its interval over seeds, or over placements where there are more.
pub fn gains() -> String {
    let rows = rows("authors/trials.csv");
    let mut settings: Vec<[&str; 5]> = Vec::new();
    let of_row =
        |row: &'_ Row| ["scene", "decoder", "steps", "noise", "limits"].map(|name| row[name].clone());
    let named: Vec<[String; 5]> = rows.iter().map(of_row).collect();
    for setting in &named {
        let setting = setting.each_ref().map(String::as_str);
        if !settings.contains(&setting) {
            settings.push(setting);
        }
    }
    let line = |&[scene, decoder, steps, noise, limits]: &[&str; 5]| {
        let wanted =
            [("scene", scene), ("decoder", decoder), ("steps", steps), ("noise", noise), ("limits", limits)];
        let own: Vec<&Row> = of(&rows, &wanted).collect();
        let gain = |set: &str| {
            let ends = ["initial", "trained"]
                .map(|body| own.iter().map(move |row| number(row, &format!("{set}_{body}"))));
            let logs: Vec<f64> = own
                .iter()
                .map(|row| {
                    (number(row, &format!("{set}_initial")) / number(row, &format!("{set}_trained"))).ln()
                })
                .collect();
            let [initial, trained] = ends.map(geometric);
            format!("{initial} → {trained} %, {}", with_interval(&logs, f64::exp))
        };
        let noise = if noise == "0" {
            "none".to_owned()
        } else {
            format!("{} %", short(&(100.0 * noise.parse::<f64>().unwrap()).to_string()))
        };
        let count = own.len().to_string();
        vec![
            scene.to_owned(),
            decoder.to_owned(),
            steps.to_owned(),
            noise,
            limits.to_owned(),
            count,
            gain("test"),
            gain("holdout"),
        ]
    };
    let columns = [
        "scene",
        "decoder",
        "outer steps",
        "noise",
        "limits",
        "trials",
        "test set, gain",
        "held-out set, gain",
    ];
    table(&columns, settings.iter().map(line))
}
