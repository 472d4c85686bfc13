use super::*;

fn row(method: &str, setting: &str, milliseconds: f64) -> String {
    format!(
        "{{\"bench\":\"dynamics\",\"instants\":200,\"scene\":\"contact\",\"method\":\"{method}\",\
             \"setting\":\"{setting}\",\"auto\":false,\"forward_ms\":{milliseconds},\"gradient_ms\":3,\
             \"signals_error\":1e-3,\"gradient_error\":null}}"
    )
}

/// A repeated measurement replaces the earlier row of its setting; other lines are ignored.
#[test]
fn the_newest_row_of_each_setting_is_drawn() {
    let lines = [row("tsit5", "1e-6", 8.0), "{\"bench\":\"brain\"}".into(), row("leapfrog", "9 steps", 2.0)]
        .into_iter()
        .chain([row("tsit5", "1e-6", 4.0)])
        .collect::<Vec<_>>()
        .join("\n");
    let marks = newest(&lines, 200);
    assert_eq!(marks.len(), 2, "{marks:?}");
    assert_eq!(marks[1].points, [Some((4.0, 1e-3)), None], "{marks:?}");
    assert!(newest(&lines, 20).is_empty());
    let svg = draw(&marks);
    assert!(svg.contains("contact, 8 × 4") && !svg.contains("reference scene"), "{svg}");
}
