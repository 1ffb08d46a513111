use super::date_of;

#[test]
fn days_are_dates() {
    let known = [(0, "1970-01-01"), (59, "1970-03-01"), (11_016, "2000-02-29"), (20_453, "2025-12-31")];
    known.iter().for_each(|(days, date)| assert_eq!(date_of(*days), *date));
}
