//! Tests of `style`.

use super::*;

/// Every variable in the styles has a value in both themes.
#[test]
fn no_colour_is_missing() {
    let file = file_style();
    assert!(!file.contains("var("), "{file}");
    // halfway from #e7e3d9 to #b3202c
    assert!(file.contains("svg .s10 { fill: #cd8283; }"), "{file}");
    assert!(file.contains("stroke: #c2410c") && file.contains("stroke: #fb8c45"), "{file}");
    let page = page_style();
    for asked in page.split("var(--").skip(1).filter_map(|rest| rest.split(')').next()) {
        let known = PALETTE.iter().any(|(name, _)| *name == asked);
        assert!(known || ["c", "x", "y", "t"].contains(&asked), "{asked}");
    }
}
