//! Tests of `picture`.

use super::*;

fn picture(title: &str) -> Picture {
    let marks = html! { path class="s5" d="M0 0H20" {} };
    Picture { title: title.into(), class: "body", view: [0.0, 0.0, 20.0, 10.0], marks }
}

/// Title and legend appear above the picture in as many lines as needed; without them the picture is at the top.
#[test]
fn title_and_legend_stand_above_the_picture() {
    let entries = (0..4).map(|i| ("initial", format!("entry {i} & more text"))).collect();
    let file = file(&[picture("the <body>")], 1, 440.0, &entries);
    assert!(file.contains(">the &lt;body&gt;</text>") && file.contains("entry 3 &amp; more text"), "{file}");
    // a line of title, two of legend
    assert!(file.contains("x=\"0.0\" y=\"51.0\" width=\"440.0\" height=\"220.0\""), "{file}");
    assert!(file.contains("viewBox=\"0 0 440 275\"") && !file.contains("var("), "{file}");
    let bare = super::file(&[picture(""), picture("")], 2, 440.0, &vec![]);
    assert!(bare.contains("x=\"220.0\" y=\"0.0\" width=\"220.0\""), "{bare}");
}

#[test]
fn words_part_lines() {
    assert_eq!(lines("some words to part", 10), ["some words", "to part"]);
    assert_eq!(lines("longer than a line", 3), ["longer", "than", "a", "line"]);
    assert!(lines("", 3).is_empty());
}
