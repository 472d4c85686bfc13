use super::*;
use std::path::Path;
use std::process::Command;

fn git(root: &Path, arguments: &[&str]) {
    let settings = ["-c", "user.name=t", "-c", "user.email=t@example.org", "-c", "init.defaultBranch=main"];
    let done = Command::new("git").arg("-C").arg(root).args(settings).args(arguments).output();
    assert!(done.is_ok_and(|output| output.status.success()), "git {arguments:?}");
}

/// Without git there is a digest but no commit. Sources that affect results change the digest; other sources only make the
/// build dirty.
#[test]
fn code_is_told_with_git_and_without() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let write = |path: &str, text: &str| {
        std::fs::create_dir_all(root.join(path).parent().unwrap()).unwrap();
        std::fs::write(root.join(path), text).unwrap();
    };
    for path in source::PROGRAM {
        write(&if path.contains('.') { path.to_owned() } else { format!("{path}/deep/a.rs") }, path);
    }
    let first = source::digest(root).unwrap();
    assert_eq!((first.len(), source::revision(root)), (16, None));
    git(root, &["init"]);
    assert_eq!(source::revision(root), None, "files that git does not know");
    git(root, &["add", "."]);
    git(root, &["commit", "-m", "one"]);
    let commit = source::revision(root).unwrap();
    assert!(commit.len() == 12 && source::moves_with_commits(root).len() == 2, "{commit}");
    write("README.md", "words");
    assert_eq!(
        (source::digest(root).unwrap(), source::revision(root).unwrap()),
        (first.clone(), commit.clone())
    );
    write("orchestrator/src/report.rs", "another look");
    assert_eq!(source::digest(root).unwrap(), first);
    assert_eq!(source::revision(root).unwrap(), format!("{commit}-dirty"));
    let with_lab = source::digest_with_lab(root).unwrap();
    write("worker/lab/src/deep/a.rs", "other fits");
    assert_eq!(source::digest(root).unwrap(), first, "no trial uses the lab");
    assert_ne!(source::digest_with_lab(root).unwrap(), with_lab);
    write("worker/src/deep/a.rs", "other sums");
    let second = source::digest(root).unwrap();
    write("worker/src/deep/a.rs", "yet other sums");
    assert!(![&first, &second].contains(&&source::digest(root).unwrap()) && first != second);
}

#[test]
fn this_program_knows_what_it_is() {
    let here = super::this_machine(3);
    assert_eq!(here.code, source::digest(&Path::new(env!("CARGO_MANIFEST_DIR")).join("..")).unwrap());
    assert!(here.rustc.starts_with("rustc 1.") && here.threads == 3 && !here.host.is_empty(), "{here:?}");
}
