use super::*;

/// On every machine, wider sets than the machine's are rejected.
#[test]
fn what_a_machine_lacks_is_refused() {
    assert_eq!(NAMES, Width::ALL.map(Width::name));
    for has in Width::ALL {
        for asked in Width::ALL {
            match find(asked.name(), has) {
                Ok(found) => assert!(found == asked && asked <= has, "{asked:?} on {has:?}: {found:?}"),
                Err(error) => {
                    let message = error.to_string();
                    assert!(asked > has && message.contains(asked.name()), "{asked:?} on {has:?}: {message}");
                    assert!(message.contains(has.name()), "{message}");
                }
            }
        }
    }
    assert_eq!(find("sse", Width::Avx2), Err(SimdError::Unknown("sse".into())));
}
