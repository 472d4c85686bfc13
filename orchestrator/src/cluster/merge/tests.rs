use super::*;

/// If the final rename fails, as after a crash, the log of a killed run is still complete.
#[tokio::test]
async fn until_the_new_file_is_in_place_nothing_of_the_old_one_is_gone() {
    let folder = tempfile::tempdir().unwrap();
    let (live, out) = (folder.path().join("live.sqlite"), folder.path().join("out.sqlite"));
    let mut store = crate::store::Store::open(&live).await.unwrap();
    let spec = "name = \"s\"\n[body]\ncolumns = 4\nrows = 4\nspacing = 15.0\nligament_length = 2.25\n\
        density = 1e-8\nstiffness = { stretch = 3.0, shear = 0.5, bend = 1.0 }\n[stimuli]\nkind = \"bell\"\n\
        samples = 8\ntest = 2\n[sweep]\npanels = [2]\nsensors = [1, 2]\n";
    let plan = crate::plan::Plan::new("s.toml", spec.into()).unwrap();
    store.begin_sweep(&plan.spec, spec, &plan.trials).await.unwrap();
    // The files as a killed run leaves them.
    for end in ["", "-wal"] {
        std::fs::copy(files::sidecar(&live, end), files::sidecar(&out, end)).unwrap();
    }
    assert!(files::has_journal(&out));
    let built = folder.path().join("built.sqlite");
    // Renaming a non-empty folder over a file fails.
    std::fs::create_dir(&built).unwrap();
    std::fs::write(built.join("x"), "").unwrap();
    let lock = store::lock(&out, false).unwrap();
    assert!(put_in_place(&built, &out, &lock).await.is_err());
    drop(lock);
    let mut reader = crate::reader::Reader::open(&out).await.unwrap();
    let rows = reader.query::<crate::look::Table>("SELECT count(*) FROM v_trial").await.unwrap().rows;
    assert_eq!(rows[0][0], 2);
}
